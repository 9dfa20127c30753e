// Anti-aliasing after shading: along silhouettes, where pixels of one head meet those of another or of
// the room, blur along the edge. Everything else is discarded and keeps what is already in the target;
// most of it never gets here (near_edges.frag).
// It costs a few lookups per pixel, whereas four samples per pixel would cost the pixel decoder four
// times. Within a head nothing is blurred: that doubled the error there (MSE 9 and 16 against many
// samples a pixel), for hair and lashes are edges too.
//
// The rectangle ends one pixel before the image does: no neighbour lies outside.

uniform sampler2D image; // alpha says whose a pixel is
uniform vec2 texel; // size of a pixel in texture coordinates

layout(location = 0) out vec4 colour;

const float REACH = 6.0; // pixels along the edge, at most

float brightness(vec3 rgb) {
    return dot(rgb, vec3(0.299, 0.587, 0.114));
}

vec3 mean_of(vec2 a, vec2 b) {
    return 0.5 * (textureLod(image, a, 0.0).rgb + textureLod(image, b, 0.0).rgb);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 at_upper_left = texelFetch(image, pixel + ivec2(-1, 1), 0);
    vec4 at_upper_right = texelFetch(image, pixel + ivec2(1, 1), 0);
    vec4 at_lower_left = texelFetch(image, pixel + ivec2(-1, -1), 0);
    vec4 at_lower_right = texelFetch(image, pixel + ivec2(1, -1), 0);
    vec3 others = vec3(at_upper_right.a, at_lower_left.a, at_lower_right.a);
    if (others == at_upper_left.aaa) {
        discard;
    }
    float upper_left = brightness(at_upper_left.rgb);
    float upper_right = brightness(at_upper_right.rgb);
    float lower_left = brightness(at_lower_left.rgb);
    float lower_right = brightness(at_lower_right.rgb);
    float darkest = min(min(upper_left, upper_right), min(lower_left, lower_right));
    float brightest = max(max(upper_left, upper_right), max(lower_left, lower_right));
    // The edge runs across the gradient; near an axis it runs far, so the blur may reach further.
    vec2 along = vec2(lower_left + lower_right - upper_left - upper_right,
                      upper_left + lower_left - upper_right - lower_right);
    float steep = min(abs(along.x), abs(along.y)) + 0.02 * (brightest + darkest) + 0.001;
    along = clamp(along / steep, -REACH, REACH) * texel;
    vec2 here = gl_FragCoord.xy * texel;
    vec3 near_pair = mean_of(here - along / 6.0, here + along / 6.0);
    vec3 far_pair = mean_of(here - along / 2.0, here + along / 2.0);
    vec3 wide = 0.5 * (near_pair + far_pair);
    float found = brightness(wide);
    // Outside the range of the neighbours the long blur has crossed another edge.
    bool crossed = found < darkest || found > brightest;
    colour = vec4(crossed ? near_pair : wide, 1.0);
}
