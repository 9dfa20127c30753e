// A table of AXIS_SIZE entries and its levels, each the mean of twice as many entries as the one
// before, folded into rows of AXIS_ROW texels: 10,000 entries are more than the narrowest texture that
// an implementation must offer. A texel holds an entry and the way to the next one, so a lookup
// between two of them reads one.
//
// `reach` is log2 of the stretch to average, in parts of the table. It chooses the level that is not
// wider; between levels nothing is mixed, for the width hardly shows.
vec2 fetch_mean(sampler2D table, float t, float reach) {
    int level = clamp(int(reach + LOG2_AXIS_SIZE), 0, AXIS_LEVELS - 1);
    float count = float(AXIS_SIZE) * intBitsToFloat((127 - level) << 23); // times 2^-level
    float place = clamp(t * count - 0.5, 0.0, ceil(count) - 1.0);
    int entry = int(place);
    int index = 2 * AXIS_STRIDE - (2 * AXIS_STRIDE >> level) + entry;
    vec4 found = texelFetch(table, ivec2(index & (AXIS_ROW - 1), index / AXIS_ROW), 0);
    return found.xy + (place - float(entry)) * found.zw;
}
