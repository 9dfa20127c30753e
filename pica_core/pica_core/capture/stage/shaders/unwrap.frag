#version 330
in vec4 clip;
in float depth_m;
in float facing;
out vec4 sum_out;
uniform sampler2D image;      // row 0 is the top row
uniform sampler2D seen_m;       // 0 where no head is
uniform float tolerance_m;
void main() {
    vec2 at = 0.5 + 0.5 * clip.xy / clip.w;
    if (facing < 0.15 || any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(1.0)))) discard;
    float nearest_m = texture(seen_m, at).r;
    // Visible: this camera's nearest surface here is this one, within the depth that a slanted pixel spans.
    if (nearest_m <= 0.0 || depth_m > nearest_m + tolerance_m / facing) discard;
    float weight = facing * facing * facing;
    sum_out = vec4(texture(image, vec2(at.x, 1.0 - at.y)).rgb * weight, weight);
}
