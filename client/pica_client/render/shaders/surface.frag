// First pass: what is visible where. Shading waits until every pixel knows its one surface, so
// hidden pixels cost nothing and the pixel decoder runs on whole blocks of pixels.

in vec2 surface_uv;
in vec3 surface_xyz_m;

uniform float slot; // 1, 2, ...; 0 is nobody
#ifdef SHARED
#endif

layout(location = 0) out vec4 xyz_and_owner;
layout(location = 1) out vec2 uv;

#include "pixels.glsl"

void main() {
#ifdef SHARED
    // Two levels of a head take turns from pixel to pixel while one gives way to the other.
    float turn = turn_of_pixel();
    if (turn < turns.x || turn >= turns.y) {
        discard;
    }
#endif
    // Derivatives are right here, within a triangle; between neighbours of the second pass there
    // may lie a silhouette or a seam of the UVs.
    float footprint = pack_footprint(dFdx(surface_uv), dFdy(surface_uv));
    xyz_and_owner = vec4(surface_xyz_m, slot + footprint);
    uv = surface_uv;
}
