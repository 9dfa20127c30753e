#version 330
in float depth_m;
flat in float seen;
out vec2 geometry_out;
void main() { geometry_out = vec2(depth_m, seen); }
