#version 330
// Exact geometry per pixel centre: distance along the camera's axis.
in vec3 position_m;
uniform mat4 clip_from_head;
uniform vec4 depth_plane;   // depth = dot(depth_plane, (point, 1))
out float depth_m;
void main() {
    depth_m = dot(depth_plane, vec4(position_m, 1.0));
    gl_Position = clip_from_head * vec4(position_m, 1.0);
}
