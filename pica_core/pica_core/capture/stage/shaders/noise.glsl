// Value noise on an integer hash: the same numbers on every driver.
uint hash_uint(uvec3 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
    v ^= v >> 16u;
    v.x += v.y * v.z; v.y += v.z * v.x; v.z += v.x * v.y;
    return v.x ^ v.y ^ v.z;
}
float hash_unit(ivec3 cell) {
    return float(hash_uint(uvec3(cell + ivec3(100000))) >> 8u) / 16777216.0;
}
float noise(vec3 p) {
    vec3 floor_p = floor(p);
    ivec3 i = ivec3(floor_p);
    vec3 f = p - floor_p;
    f = f * f * (3.0 - 2.0 * f);
    float x00 = mix(hash_unit(i), hash_unit(i + ivec3(1, 0, 0)), f.x);
    float x10 = mix(hash_unit(i + ivec3(0, 1, 0)), hash_unit(i + ivec3(1, 1, 0)), f.x);
    float x01 = mix(hash_unit(i + ivec3(0, 0, 1)), hash_unit(i + ivec3(1, 0, 1)), f.x);
    float x11 = mix(hash_unit(i + ivec3(0, 1, 1)), hash_unit(i + ivec3(1, 1, 1)), f.x);
    return mix(mix(x00, x10, f.y), mix(x01, x11, f.y), f.z);
}
float fbm(vec3 p) {
    return 0.5 * noise(p) + 0.27 * noise(p * 2.03 + 7.1) + 0.15 * noise(p * 4.1 + 3.3)
        + 0.08 * noise(p * 8.3 + 1.7);
}
// Round spots, one at most per cell of unit size: 1 in a spot, 0 outside.
float spots(vec3 p, float share, float radius) {
    ivec3 base = ivec3(floor(p));
    float found = 0.0;
    for (int dx = -1; dx <= 1; dx++) for (int dy = -1; dy <= 1; dy++) for (int dz = -1; dz <= 1; dz++) {
        ivec3 c = base + ivec3(dx, dy, dz);
        if (hash_unit(c) > share) continue;
        vec3 centre = vec3(c) + vec3(hash_unit(c + 31), hash_unit(c + 57), hash_unit(c + 83));
        float size = radius * (0.5 + hash_unit(c + 11));
        found = max(found, 1.0 - smoothstep(0.5 * size, size, distance(p, centre)));
    }
    return found;
}
