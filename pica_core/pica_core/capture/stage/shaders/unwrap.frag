#version 330
in vec4 clip;
in float depth_m;
in float facing;
out vec4 sum_out;
uniform sampler2D image;      // row 0 is the bottom row
uniform sampler2D geometry;
uniform float tolerance_m;
void main() {
    vec2 at = 0.5 + 0.5 * clip.xy / clip.w;
    if (facing < 0.15 || any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(1.0)))) discard;
    vec2 nearest = texture(geometry, at).rg;
    // Visible: this camera's nearest surface here is this one, within the depth that a slanted pixel spans.
    if (nearest.g < 0.5 || depth_m > nearest.r + tolerance_m / facing) discard;
    float weight = facing * facing * facing;
    sum_out = vec4(texture(image, at).rgb * weight, weight);
}
