// Whether a pixel of a layer is of its head, 0 or 1; those beyond its border are as those at it.
float covered(ivec2 pixel) {
    vec2 texel = 1.0 / vec2(textureSize(layer_depth, 0));
    return float(textureLod(layer_depth, (vec2(pixel) + 0.5) * texel, 0.0).r < 1.0);
}
