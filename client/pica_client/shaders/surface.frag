// First pass: what is visible where. Shading waits until every pixel knows its one surface, so
// hidden pixels cost nothing and the pixel decoder runs on whole blocks of pixels.

in vec2 surface_uv;
in vec3 surface_xyz_m;

uniform float slot; // 1, 2, ...; 0 is nobody

layout(location = 0) out vec4 xyz_and_slot;
layout(location = 1) out vec2 uv;

void main() {
    xyz_and_slot = vec4(surface_xyz_m, slot);
    uv = surface_uv;
}
