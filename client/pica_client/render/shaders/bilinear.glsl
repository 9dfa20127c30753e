// Lookups by texelFetch, for textures that a sampler may not filter: 32-bit float ones are not
// filterable in GLSL ES 3.00. Texel centres at (i + 0.5) / size, clamped to the edge. The image
// is a part of the texture: rows.y rows from rows.x on.

vec4 fetch_bilinear(sampler2D image, vec2 uv, ivec2 rows) {
    ivec2 last = ivec2(textureSize(image, 0).x, rows.y) - 1;
    vec2 place = uv * vec2(last + 1) - 0.5;
    vec2 corner = floor(place);
    vec2 weight = place - corner;
    ivec2 first = ivec2(0, rows.x);
    ivec2 low = clamp(ivec2(corner), ivec2(0), last) + first;
    ivec2 high = clamp(ivec2(corner) + 1, ivec2(0), last) + first;
    vec4 upper = mix(texelFetch(image, low, 0), texelFetch(image, ivec2(high.x, low.y), 0), weight.x);
    vec4 lower = mix(texelFetch(image, ivec2(low.x, high.y), 0), texelFetch(image, high, 0), weight.x);
    return mix(upper, lower, weight.y);
}
