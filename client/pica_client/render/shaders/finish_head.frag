// A head's layer as it is laid over the room.
//
// Anti-aliasing after shading: pixels at the silhouette are mixed with their neighbours, colours and how
// much of them is there alike. Within a head nothing is blurred: that doubled the error there (MSE 9
// and 16 against many samples a pixel), for hair and lashes are edges too. Four samples a pixel would
// cost the pixel decoder four times; a blur along the edge alone, in a pass that a depth test confines
// to edges, costs twice as much and leaves as much error (MSE at silhouettes 47 and 40, 136 without).
//
// Where a bust fades it still hides who is behind it, for neighbours who fade at one height would show
// through each other, until little is left of it: there the room is laid in before. How much is left is
// known row by row, for its nearest and its farthest side: what a pixel has less of than the less of
// them, is not covered. Above, where all of it is there, none of this is needed.

in vec2 place;

uniform sampler2D layer; // colours times how much of them is there, and that
uniform float step; // from one pixel to the next in how much is there, where an edge is
#ifdef FADING
uniform sampler2D room;
uniform vec3 corner; // of the layer in the image; pixels of the layer for each of the image
uniform float opacity;
uniform vec4 fading; // rows of the image: nothing is left of one side, all of it is there, of the other

const float HIDING = 3.0;
#endif

layout(location = 0) out vec4 colour;

void main() {
    vec2 texel = 1.0 / vec2(textureSize(layer, 0));
    vec4 own = textureLod(layer, place, 0.0);
    vec4 above = textureLod(layer, place + vec2(0.0, texel.y), 0.0);
    vec4 below = textureLod(layer, place - vec2(0.0, texel.y), 0.0);
    vec4 left = textureLod(layer, place - vec2(texel.x, 0.0), 0.0);
    vec4 right = textureLod(layer, place + vec2(texel.x, 0.0), 0.0);
    float most = max(max(above.a, below.a), max(left.a, right.a));
    float least = min(min(above.a, below.a), min(left.a, right.a));
    colour = most - least > step ? 0.5 * own + 0.125 * (above + below + left + right) : own;
#ifdef FADING
    vec2 pixel = corner.xy + gl_FragCoord.xy / corner.z;
    vec3 behind = textureLod(room, pixel / vec2(textureSize(room, 0)), 0.0).rgb;
    vec2 there = smoothstep(fading.xz, fading.yw, pixel.yy);
    float hides = min(colour.a / max(there.x, 1e-3), 1.0) * min(HIDING * there.y, 1.0);
    colour = vec4(opacity * colour.rgb + (hides - opacity * colour.a) * behind, hides);
#endif
}
