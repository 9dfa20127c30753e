// Kajiya-Kay strands with a shifted second lobe (Scheuermann 2004), under lights that the including shader names.
void strands(vec3 n, vec3 tangent, vec3 v, vec4 relief, vec3 diffuse, float gloss, float sky, float key, out vec3 lit, out vec3 shine) {
    vec3 t = normalize(tangent - n * dot(n, tangent) + n * (relief.b - 0.5) * 0.16);
    vec3 h = normalize(key_direction + v);
    vec3 hf = normalize(rim_direction + v);
    float s1 = pow(max(1.0 - pow(dot(t, h), 2.0), 0.0), 45.0);
    float s2 = pow(max(1.0 - pow(dot(normalize(t + 0.18 * n), h), 2.0), 0.0), 9.0);
    float s3 = pow(max(1.0 - pow(dot(t, hf), 2.0), 0.0), 24.0) * smoothstep(-0.2, 0.5, dot(n, rim_direction));
    vec3 soft = wrapped(n, key_direction, vec3(0.35)) * key * key_light
        + wrapped(n, fill_direction, vec3(0.4)) * sky * fill_light + dome(n) * sky;
    float facing = smoothstep(-0.25, 0.5, dot(n, key_direction)) * key;
    shine = (vec3(0.085) * s1 + diffuse * 1.5 * s2) * facing * (0.4 + gloss) + vec3(0.05) * s3 * sky;
    lit = diffuse * soft * mix(0.55, 1.0, smoothstep(0.0, 0.6, relief.r));
}
