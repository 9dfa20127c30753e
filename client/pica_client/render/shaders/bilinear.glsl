// Lookups by texelFetch, for textures that a sampler may not filter: 32-bit float ones are not
// filterable in GLSL ES 3.00. Texel centres at (i + 0.5) / size, clamped to the edge.

vec4 fetch_bilinear(sampler2D image, vec2 uv) {
    ivec2 last = textureSize(image, 0) - 1;
    vec2 place = uv * vec2(last + 1) - 0.5;
    vec2 corner = floor(place);
    vec2 weight = place - corner;
    ivec2 low = clamp(ivec2(corner), ivec2(0), last);
    ivec2 high = clamp(ivec2(corner) + 1, ivec2(0), last);
    vec4 upper = mix(texelFetch(image, low, 0), texelFetch(image, ivec2(high.x, low.y), 0), weight.x);
    vec4 lower = mix(texelFetch(image, ivec2(low.x, high.y), 0), texelFetch(image, high, 0), weight.x);
    return mix(upper, lower, weight.y);
}
