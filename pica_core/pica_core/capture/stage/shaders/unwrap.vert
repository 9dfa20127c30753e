#version 330
// Draws the mesh flat into its UV square and looks each texel up in one camera's image.
in vec3 position_m;
in vec3 normal;
in vec2 vertex_uv;
uniform mat4 clip_from_head;
uniform vec4 depth_plane;
uniform vec3 camera_m;
out vec4 clip;
out float depth_m;
out float facing;
void main() {
    clip = clip_from_head * vec4(position_m, 1.0);
    depth_m = dot(depth_plane, vec4(position_m, 1.0));
    facing = dot(normal, normalize(camera_m - position_m));
    gl_Position = vec4(vertex_uv * 2.0 - 1.0, 0.0, 1.0);
}
