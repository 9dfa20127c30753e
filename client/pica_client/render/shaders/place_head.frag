// A head from its layer into the image, where nothing nearer is there. The room lies behind all heads,
// so no order of drawing is needed.

in vec2 place; // 0..1 within the rectangle

uniform sampler2D room;
uniform sampler2D layer; // colours, and how much of them is there
uniform sampler2D layer_depth; // 1 is nothing
uniform vec4 within; // the rectangle in the room: its lower left corner, and its sides
uniform vec2 filled; // the part of the layer that the rectangle fills
uniform float opacity;
uniform float slot;

layout(location = 0) out vec4 colour;

#include "mark.glsl"

void main() {
    float depth = textureLod(layer_depth, filled * place, 0.0).r;
    if (depth == 1.0) {
        discard;
    }
    gl_FragDepth = depth;
    vec4 head = textureLod(layer, filled * place, 0.0);
    vec3 behind = textureLod(room, within.xy + within.zw * place, 0.0).rgb;
    colour = vec4(mix(behind, head.rgb, opacity * head.a), mark_of(slot));
}
