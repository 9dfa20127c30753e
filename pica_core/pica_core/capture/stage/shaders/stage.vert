#version 330
in vec3 position_m;
in vec3 normal;
in vec2 occlusion;
in vec3 tangent;
in float folded;
in vec2 vertex_uv;
uniform mat4 clip_from_head;
out vec3 point_m;
out vec3 shading_normal;
out vec2 open_sky;
out vec3 strand_tangent;
out float fold;
out vec2 uv;
void main() {
    point_m = position_m;
    shading_normal = normal;
    open_sky = occlusion;
    strand_tangent = tangent;
    fold = folded;
    uv = vertex_uv;
    gl_Position = clip_from_head * vec4(position_m, 1.0);
}
