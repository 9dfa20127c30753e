// One vertex of an avatar: its UV is fixed, its position comes out of what was decoded.

in vec2 vertex_place; // where to look its position up: its UV in a position map, its slot in a sheet
in vec2 vertex_uv;

uniform sampler2D position_map; // head-frame metres
uniform ivec2 position_rows; // of this head: the first, and how many
uniform mat4 clip_from_head;
uniform vec3 low_m; // the box that the avatar promised to stay in
uniform vec3 high_m;

out vec2 surface_uv;
out vec3 surface_xyz_m;

#include "bilinear.glsl"
#include "bounded.glsl"

void main() {
    surface_uv = vertex_uv;
    vec3 xyz_m = fetch_bilinear(position_map, vertex_place, position_rows).xyz;
    surface_xyz_m = bounded(xyz_m, low_m, high_m);
    gl_Position = clip_from_head * vec4(surface_xyz_m, 1.0);
}
