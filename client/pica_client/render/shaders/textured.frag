// A baseline avatar: one lookup in the texture that its decoder made.

in vec2 surface_uv;
in vec3 surface_xyz_m;

uniform sampler2D skin; // row 0 is v = 0
uniform float slot;

layout(location = 0) out vec4 colour;

#include "mark.glsl"
#include "bust.glsl"

void main() {
    colour = vec4(before_room(texture(skin, surface_uv).rgb, surface_xyz_m), mark_of(slot));
}
