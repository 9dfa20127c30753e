// What the passes over a head's pixels share.

uniform vec2 shown; // height at which nothing is left of a bust, height from which all is there

// How a head passes into the room: towards its lower border it fades out.
float presence(vec3 xyz_m) {
    return smoothstep(shown.x, shown.y, xyz_m.y);
}

// The surface pass writes, packed into a fraction below 1, how far a pixel reaches across the texture,
// along u and along v: sixteenths of an octave from 2^-15 (a third of an entry in a table of 10,000) to
// almost 2.
const float FOOTPRINT_OCTAVE = 16.0;
const float FOOTPRINT_FINEST = 15.0;

float pack_footprint(vec2 across, vec2 down) {
    // The bits of a float, read as a number, are nearly its logarithm: 0.09 octaves of the square,
    // 0.04 of the reach, at most. Three of the mantissa's bits are eighths of an octave of the
    // square, so sixteenths of the reach. Roots and logarithms took a fifth of the pass (llvmpipe).
    ivec2 square = floatBitsToInt(across * across + down * down) >> 20;
    ivec2 code = clamp(square - ((127 - 30) << 3), 0, 255);
    return float((code.x << 8) + code.y) / 65536.0;
}

// log2 of the reach along u and v, in parts of the texture.
vec2 unpack_footprint(float packed_reach) {
    float high = packed_reach * 256.0;
    vec2 code = vec2(floor(high), fract(high) * 256.0);
    return code / FOOTPRINT_OCTAVE - FOOTPRINT_FINEST;
}
