// A mesh laid out flat by its UVs, nine times: as it is, and moved by a margin to eight sides behind
// that, so that what lies beside a chart has the colours of its border.

in vec3 vertex_xyz_m;
in vec2 vertex_uv;

uniform float margin; // in parts of the texture

out vec2 surface_uv;
out vec3 surface_xyz_m;

void main() {
    surface_uv = vertex_uv;
    surface_xyz_m = vertex_xyz_m;
    int side = (gl_InstanceID + 4) % 9; // the fourth is the middle
    vec2 moved = margin * vec2(side % 3 - 1, side / 3 - 1);
    gl_Position = vec4(2.0 * (vertex_uv + moved) - 1.0, side == 4 ? 0.0 : 0.5, 1.0);
}
