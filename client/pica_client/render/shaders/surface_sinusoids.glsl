// Sines and cosines of 2 pi 2^k (u, v): one octave in each vector.

const float TURN = 6.283185307179586;

// sin u, sin v, cos u, cos v of octave k. `reach` is log2 of how far the pixel reaches along u and v:
// the mean of a wave over w of its periods is sin(pi w) / (pi w) of it; beyond one period nothing is
// left. The polynomial is off by less than 0.003.
vec4 octave_code(vec2 uv, vec2 reach, float k) {
    vec2 angle = fract(uv * exp2(k)) * TURN;
    vec4 code = vec4(sin(angle), cos(angle));
#ifdef FILTERED
    vec2 w = min(exp2(reach + k), 1.0);
    vec2 q = w * w;
    vec2 mean = (1.0 - q) * (1.0 - q * (0.6449 - 0.165 * q));
    code *= vec4(mean, mean);
#endif
    return code;
}
