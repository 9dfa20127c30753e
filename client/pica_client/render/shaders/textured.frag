// A baseline avatar: one lookup in the texture that its decoder made.

in vec2 surface_uv;

uniform sampler2D skin; // row 0 is v = 0
uniform vec4 tint;
uniform float slot;

layout(location = 0) out vec4 colour;

#include "mark.glsl"

void main() {
    colour = vec4(mix(texture(skin, surface_uv).rgb, tint.rgb, tint.a), mark_of(slot));
}
