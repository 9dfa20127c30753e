// A head from its layer into the image, over what is there.
//
// Where busts fade they hide who is behind them for as long as they can be made out: with less than
// that, neighbours who fade at one height would show through each other.

in vec2 place; // 0..1 within the rectangle

uniform sampler2D layer; // colours times how much of them is there, and that
uniform sampler2D room;
uniform vec4 within; // the rectangle in the room: its lower left corner, and its sides
uniform vec2 filled; // the part of the layer that the rectangle fills
uniform float opacity;
uniform float fading; // below this row of the image

layout(location = 0) out vec4 colour;

const float HIDING = 3.0;

void main() {
    vec4 head = textureLod(layer, filled * place, 0.0);
    vec3 behind = textureLod(room, within.xy + within.zw * place, 0.0).rgb;
    float hides = gl_FragCoord.y < fading ? min(HIDING * head.a, 1.0) : head.a;
    colour = vec4(opacity * head.rgb + (hides - opacity * head.a) * behind, hides);
}
