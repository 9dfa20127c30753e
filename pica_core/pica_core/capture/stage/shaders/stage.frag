#version 330
// Light on the stage: a dome (soft, from everywhere), a large key and a fill, all fixed to the head.
in vec3 point_m;
in vec3 shading_normal;
in vec3 strand_tangent;
in vec2 open_sky;     // x: share of the dome that is seen, y: share of the key light
in vec2 uv;
const int material_id = MATERIAL;   // a program each: software GL runs every branch
out vec4 colour_out;
uniform vec3 camera_m;
uniform sampler2D colour_map;
uniform sampler2D relief_map;

const vec3 key_direction = normalize(vec3(0.50, 0.55, 0.80));
const vec3 fill_direction = normalize(vec3(-0.70, 0.10, 0.60));
const vec3 rim_direction = normalize(vec3(-0.55, 0.50, -0.70));
const vec3 key_light = vec3(1.70, 1.60, 1.46);
const vec3 fill_light = vec3(0.34, 0.38, 0.44);
const vec3 rim_light = vec3(0.55, 0.56, 0.60);

vec3 dome(vec3 n) { return mix(vec3(0.22, 0.19, 0.18), vec3(0.58, 0.61, 0.66), 0.5 + 0.5 * n.y); }
// What a mirror would see: a bright softbox overhead and a window to the side.
float softboxes(vec3 r) {
    float box = smoothstep(0.915, 0.94, dot(r, key_direction));
    float window = smoothstep(0.96, 0.975, dot(r, fill_direction)) * 0.20;
    return box + window + 0.10 * smoothstep(-0.2, 0.9, r.y);
}
vec3 wrapped(vec3 n, vec3 l, vec3 wrap) { return max(vec3(dot(n, l)) + wrap, 0.0) / (1.0 + wrap); }
float lobe(vec3 n, vec3 h, float power) { return (power + 8.0) / 25.0 * pow(max(dot(n, h), 0.0), power); }

// Mikkelsen, "Bump mapping unparametrized surfaces on the GPU" (2010): height needs no tangent frame.
vec3 bumped(vec3 n, float height, float strength) {
    vec3 dx = dFdx(point_m), dy = dFdy(point_m);
    vec3 r1 = cross(dy, n), r2 = cross(n, dx);
    float det = dot(dx, r1);
    vec3 slope = sign(det) * (dFdx(height) * r1 + dFdy(height) * r2);
    return normalize(abs(det) * n - strength * slope);
}
#include "strands.glsl"

void main() {
    vec4 stored = texture(colour_map, uv);
    vec4 relief = texture(relief_map, uv);
    vec3 diffuse = stored.rgb * stored.rgb;
    float gloss = stored.a;
    vec3 n = normalize(shading_normal);
    vec3 v = normalize(camera_m - point_m);
    float sky = max(open_sky.x, 0.0), key = max(open_sky.y, 0.0);   // rounding goes below 0, roots do not
    // Shadow is known per vertex for a few expressions only; inside the mouth keep what bounces around.
    if (material_id == 2) { sky = max(sky, 0.42) * (1.0 - 0.85 * relief.g); key = max(key, 0.24) * (1.0 - 0.95 * relief.g); }
    else if (material_id == 1) { sky = max(sky, 0.20); key = max(key, 0.08); }
    else if (material_id == 3) { sky = max(sky, 0.30); key = max(key, 0.12); }
    else if (material_id == 4) { sky = max(sky, 0.22); }
    vec3 lit;
    vec3 shine = vec3(0.0);
    if (material_id == 6) {
        strands(bumped(n, relief.r, 0.0012), strand_tangent, v, relief, diffuse, gloss, sky, key, lit, shine);
    } else {
        float bump = material_id == 0 ? 0.00075 : (material_id == 5 ? 0.0006 : 0.0002);
        vec3 nb = bumped(n, relief.r, bump);
        float under = material_id == 0 ? relief.g : 0.0;   // light that passes under the surface
        vec3 wrap = under * vec3(0.42, 0.16, 0.08);
        vec3 occluded = pow(vec3(sky), mix(vec3(1.0), vec3(0.72, 1.0, 1.08), under)); // light bleeds red in creases
        lit = wrapped(nb, key_direction, wrap) * key_light * mix(vec3(key), vec3(sqrt(key), key, key), 0.5 * under)
            + wrapped(nb, fill_direction, wrap) * fill_light * occluded
            + wrapped(nb, rim_direction, wrap) * rim_light * occluded
            + dome(nb) * occluded;
        lit *= diffuse;
        float grazing = pow(1.0 - max(dot(nb, v), 0.0), 5.0);
        vec3 h = normalize(key_direction + v);
        vec3 hf = normalize(fill_direction + v);
        vec3 hr = normalize(rim_direction + v);
        if (material_id == 1) {
            // Cornea: a sharp picture of the lights.
            vec3 mirrored = reflect(-v, n);
            float fresnel = 0.035 + 0.6 * grazing;
            shine = vec3(softboxes(mirrored)) * (0.34 + fresnel) * smoothstep(0.05, 0.5, sky) * 1.5;
            lit *= 0.92;
        } else if (material_id >= 2 && material_id <= 4) {
            float f = 0.045 + 0.5 * grazing;
            shine = f * gloss * (1.4 * lobe(nb, h, 90.0) * key + 0.5 * lobe(nb, hf, 60.0) * sky) + f * 0.4 * dome(nb) * sky * gloss;
        } else {
            // Two lobes of skin oil: broad and tight (wet lips have more of the tight one).
            float f = 0.034 + 0.34 * grazing;
            float broad = lobe(nb, h, 11.0) * key * 0.9 + lobe(nb, hf, 11.0) * sky * 0.30 + lobe(nb, hr, 9.0) * sky * 0.35;
            float tight = lobe(nb, h, 42.0) * key + lobe(nb, hf, 42.0) * sky * 0.35;
            float wet = smoothstep(0.58, 0.95, gloss);
            shine = vec3(f * gloss * (1.5 * broad + 1.1 * tight + 4.0 * wet * lobe(nb, h, 130.0) * key));
        }
    }
    vec3 linear = max(lit + shine, 0.0) * 0.92;
    linear = linear * (1.0 + linear * 0.16) / (1.0 + 0.42 * linear);   // soft shoulder
    vec3 srgb = mix(12.92 * linear, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, linear));
    colour_out = vec4(clamp(srgb, 0.0, 1.0), 1.0);
}
