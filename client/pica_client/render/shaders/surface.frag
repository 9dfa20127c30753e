// First pass: what is visible where. Shading waits until every pixel knows its one surface, so
// hidden pixels cost nothing and the pixel decoder runs on whole blocks of pixels.

in vec2 surface_uv;
in vec3 surface_xyz_m;

layout(location = 0) out vec4 xyz_and_footprint;
layout(location = 1) out vec2 uv;

#include "pixels.glsl"

void main() {
    // Derivatives are right here, within a triangle; between neighbours of the second pass there
    // may lie a silhouette or a seam of the UVs.
    float footprint = pack_footprint(dFdx(surface_uv), dFdy(surface_uv));
    xyz_and_footprint = vec4(surface_xyz_m, footprint);
    uv = surface_uv;
}
