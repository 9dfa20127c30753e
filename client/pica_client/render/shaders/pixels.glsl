// What the passes over a head's pixels share.

uniform vec2 shown; // height at which nothing is left of a bust, height from which all is there
// The share of the pixels that a level of a head gets, from and to, where two of them are mixed; the
// layer's corner in the image.
uniform vec4 turns;

// How a head passes into the room: towards its lower border it fades out.
float presence(vec3 xyz_m) {
    return smoothstep(shown.x, shown.y, xyz_m.y);
}

// A number from 0 to 1 for each pixel of the image, spread evenly over neighbours: two surfaces that
// give way to one another take turns by it.
float turn_of_pixel() {
    return fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy) + turns.zw, vec2(0.06711056, 0.00583715))));
}

// The surface pass writes the number of the head, and beside it, packed into a fraction below 1, how
// far a pixel reaches across the texture, along u and along v: sixteenths of an octave from 2^-15 (a
// third of an entry in a table of 10,000) to almost 2. So it costs no memory of its own.
const float FOOTPRINT_OCTAVE = 16.0;
const float FOOTPRINT_FINEST = 15.0;

bool is_owner(float owner, float slot) {
    return floor(owner) == slot;
}

float pack_footprint(vec2 across, vec2 down) {
    // The bits of a float, read as a number, are nearly its logarithm: 0.09 octaves of the square,
    // 0.04 of the reach, at most. Three of the mantissa's bits are eighths of an octave of the
    // square, so sixteenths of the reach. Roots and logarithms took a fifth of the pass (llvmpipe).
    ivec2 square = floatBitsToInt(across * across + down * down) >> 20;
    ivec2 code = clamp(square - ((127 - 30) << 3), 0, 255);
    return float((code.x << 8) + code.y) / 65536.0;
}

// log2 of the reach along u and v, in parts of the texture.
vec2 unpack_footprint(float owner) {
    float high = fract(owner) * 256.0;
    vec2 code = vec2(floor(high), fract(high) * 256.0);
    return code / FOOTPRINT_OCTAVE - FOOTPRINT_FINEST;
}
