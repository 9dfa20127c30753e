// A table of `count` entries, folded into rows of AXIS_ROW texels: 10,000 entries are more than the
// narrowest texture that an implementation must offer.
vec2 fetch_linear(sampler2D table, int count, float t) {
    float place = t * float(count) - 0.5;
    float corner = floor(place);
    int low = clamp(int(corner), 0, count - 1);
    int high = clamp(int(corner) + 1, 0, count - 1);
    vec2 a = texelFetch(table, ivec2(low % AXIS_ROW, low / AXIS_ROW), 0).xy;
    vec2 b = texelFetch(table, ivec2(high % AXIS_ROW, high / AXIS_ROW), 0).xy;
    return mix(a, b, place - corner);
}
