// How far a pixel reaches across the texture, along u and along v, packed into a fraction below 1:
// it travels beside the number of the head, and costs no memory of its own. Sixteenths of an
// octave from 2^-15 (a third of an entry in a table of 10,000) to almost 2.

const float FOOTPRINT_OCTAVE = 16.0;
const float FOOTPRINT_FINEST = 15.0;

float pack_footprint(vec2 across, vec2 down) {
    vec2 reach = sqrt(across * across + down * down);
    vec2 code = floor(clamp((log2(reach) + FOOTPRINT_FINEST) * FOOTPRINT_OCTAVE, 0.0, 255.0));
    return (code.x + code.y / 256.0) / 256.0;
}

// log2 of the reach along u and v, in parts of the texture.
vec2 unpack_footprint(float owner) {
    float high = fract(owner) * 256.0;
    vec2 code = vec2(floor(high), fract(high) * 256.0);
    return code / FOOTPRINT_OCTAVE - FOOTPRINT_FINEST;
}
