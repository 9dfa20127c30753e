// One vertex of a baseline avatar: decoded as it is, no map between.

in vec3 vertex_xyz_m;
in vec2 vertex_uv;

uniform mat4 clip_from_head;
uniform vec3 low_m;
uniform vec3 high_m;

out vec2 surface_uv;
out vec3 surface_xyz_m;

#include "bounded.glsl"
#include "yielding.glsl"

void main() {
    surface_uv = vertex_uv;
    surface_xyz_m = bounded(vertex_xyz_m, low_m, high_m);
    gl_Position = yielding(clip_from_head * vec4(surface_xyz_m, 1.0), surface_xyz_m.y);
}
