// A table of `count` entries, folded into rows of AXIS_ROW texels: 10,000 entries are more than the
// narrowest texture that an implementation must offer.
//
// Texel i holds the sum of the entries before i, and entry i: so the mean of any stretch of the
// table is the difference of two lookups. A stretch of one entry is linear interpolation.
vec2 sum_up_to(sampler2D table, int count, float place) {
    int entry = clamp(int(floor(place)), 0, count - 1);
    vec4 found = texelFetch(table, ivec2(entry & (AXIS_ROW - 1), entry / AXIS_ROW), 0);
    return found.xy + (place - float(entry)) * found.zw;
}

// The mean over `reach` (parts of the table, at least one entry) around t; beyond its ends a table
// goes on with its last entry.
vec2 fetch_mean(sampler2D table, int count, float t, float reach) {
    float middle = t * float(count);
    float half_reach = 0.5 * max(reach * float(count), 1.0);
    vec2 sum = sum_up_to(table, count, middle + half_reach)
        - sum_up_to(table, count, middle - half_reach);
    return sum / (2.0 * half_reach);
}
