#version 330
in float depth_m;
out float geometry_out;
void main() { geometry_out = depth_m; }
