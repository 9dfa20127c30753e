// One vertex of a surface with a texture: where it is given, no map between.

in vec3 vertex_xyz_m;
in vec2 vertex_uv;
#ifdef STATIC
in float vertex_opacity;
#endif

uniform mat4 clip_from_head;
uniform vec3 low_m;
uniform vec3 high_m;

out vec2 surface_uv;
out vec3 surface_xyz_m;
#ifdef STATIC
out float surface_opacity;

// A static surface counts as so much nearer: below its seam lies the decoded one, in a finer mesh.
const float NEARER_M = 0.002;
#endif

#include "bounded.glsl"

void main() {
    surface_uv = vertex_uv;
    surface_xyz_m = bounded(vertex_xyz_m, low_m, high_m);
    gl_Position = clip_from_head * vec4(surface_xyz_m, 1.0);
#ifdef STATIC
    surface_opacity = vertex_opacity;
    // The distance from the far plane grows as the depth shrinks, and with it the depth buffer.
    float away_m = max(gl_Position.w, 1e-3);
    gl_Position.z = gl_Position.w - (gl_Position.w - gl_Position.z) * (away_m + NEARER_M) / away_m;
#endif
}
