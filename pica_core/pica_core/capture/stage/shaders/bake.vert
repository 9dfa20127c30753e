#version 330
// Draws a head flat into its UV square: one fragment per texel of the appearance textures.
in vec2 vertex_uv;
in vec3 rest_m;
in vec4 local;
in vec2 source_uv;
in vec3 strand;
in vec3 tint;
out vec3 rest_mm;
out vec4 surface;
out vec2 albedo_uv;
out vec3 strand_way;
out vec3 tinted;
void main() {
    rest_mm = rest_m * 1000.0;
    surface = local;
    albedo_uv = source_uv;
    strand_way = strand;
    tinted = tint;
    gl_Position = vec4(vertex_uv * 2.0 - 1.0, 0.0, 1.0);
}
