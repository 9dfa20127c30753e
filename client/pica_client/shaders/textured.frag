// A baseline avatar: one lookup in the texture that its decoder made.

in vec2 surface_uv;

uniform sampler2D skin; // row 0 is v = 0
uniform vec4 tint;

layout(location = 0) out vec4 colour;

#include "brightness.glsl"

void main() {
    vec3 rgb = mix(texture(skin, surface_uv).rgb, tint.rgb, tint.a);
    colour = vec4(rgb, brightness(rgb));
}
