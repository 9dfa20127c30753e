// A head from its layer into the image, over what is there.
//
// Where a bust fades it still hides who is behind it, for neighbours who fade at one height would show
// through each other, until little is left of it. How much is left is known row by row, for its nearest
// and its farthest side: what a pixel has less of than the less of them, is not covered.

in vec2 place; // 0..1 within the rectangle

uniform sampler2D layer; // colours times how much of them is there, and that
uniform sampler2D room;
uniform vec4 within; // the rectangle in the room: its lower left corner, and its sides
uniform vec2 filled; // the part of the layer that the rectangle fills
uniform float opacity;
uniform vec4 fading; // rows of the image: nothing is left of one side, all of it is there, of the other

layout(location = 0) out vec4 colour;

const float HIDING = 3.0;

void main() {
    vec4 head = textureLod(layer, filled * place, 0.0);
    vec3 behind = textureLod(room, within.xy + within.zw * place, 0.0).rgb;
    float least = smoothstep(fading.x, fading.y, gl_FragCoord.y);
    float most = smoothstep(fading.z, fading.w, gl_FragCoord.y);
    float hides = min(head.a / max(least, 1e-3), 1.0) * min(HIDING * most, 1.0);
    colour = vec4(opacity * head.rgb + (hides - opacity * head.a) * behind, hides);
}
