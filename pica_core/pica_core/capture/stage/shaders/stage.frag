#version 330
// The stage's light: a soft dome, a large key, a fill and a rim, all fixed to the head.
in vec3 point_m;
in vec3 shading_normal;
in vec3 strand_tangent;
in vec2 open_sky;     // x: share of the dome that is seen, y: share of the key light
in float fold;         // of skin: 0 smooth, 1 folded
in vec2 uv;
const int material_id = MATERIAL;   // a program each: software GL runs every branch
out vec4 colour_out;
uniform vec3 camera_m;
uniform sampler2D colour_map;
uniform sampler2D relief_map;

const vec3 key_direction = normalize(vec3(0.50, 0.55, 0.80));   // as in shadow.py
const vec3 fill_direction = normalize(vec3(-0.70, 0.10, 0.60));
const vec3 rim_direction = normalize(vec3(-0.55, 0.50, -0.70));
const vec3 key_light = vec3(1.42, 1.34, 1.22);
const vec3 fill_light = vec3(0.34, 0.38, 0.44);
const vec3 rim_light = vec3(0.55, 0.56, 0.60);

vec3 dome(vec3 n) { return mix(vec3(0.33, 0.29, 0.27), vec3(0.70, 0.73, 0.78), 0.5 + 0.5 * n.y); }
vec3 wrapped(vec3 n, vec3 l, vec3 wrap) { return max(vec3(dot(n, l)) + wrap, 0.0) / (1.0 + wrap); }
float lobe(vec3 n, vec3 h, float power) { return (power + 8.0) / 25.0 * pow(max(dot(n, h), 0.0), power); }
// Mikkelsen, "Bump mapping unparametrized surfaces on the GPU" (2010).
vec3 bumped(vec3 n, float height, float strength) {
    vec3 dx = dFdx(point_m), dy = dFdy(point_m);
    vec3 r1 = cross(dy, n), r2 = cross(n, dx);
    float det = dot(dx, r1);
    return normalize(abs(det) * n - strength * sign(det) * (dFdx(height) * r1 + dFdy(height) * r2));
}
// Kajiya-Kay strands with a shifted second lobe (Scheuermann 2004).
void strands(vec3 n, vec3 tangent, vec3 v, vec4 relief, vec3 diffuse, float gloss, float sky, float key, out vec3 lit, out vec3 shine) {
    vec3 t = normalize(tangent - n * dot(n, tangent) + n * (relief.b - 0.5) * 0.16);
    vec3 h = normalize(key_direction + v);
    vec3 hf = normalize(rim_direction + v);
    float s1 = pow(max(1.0 - pow(dot(t, h), 2.0), 0.0), 45.0);
    float s2 = pow(max(1.0 - pow(dot(normalize(t + 0.18 * n), h), 2.0), 0.0), 9.0);
    float s3 = pow(max(1.0 - pow(dot(t, hf), 2.0), 0.0), 24.0) * smoothstep(-0.2, 0.5, dot(n, rim_direction));
    vec3 soft = wrapped(n, key_direction, vec3(0.35)) * key * key_light
        + wrapped(n, fill_direction, vec3(0.4)) * sky * fill_light + dome(n) * sky;
    float facing = smoothstep(-0.25, 0.5, dot(n, key_direction)) * key;
    shine = (vec3(0.085) * s1 + diffuse * 1.5 * s2) * facing * (0.4 + gloss) + vec3(0.05) * s3 * sky;
    lit = diffuse * soft * mix(0.55, 1.0, smoothstep(0.0, 0.6, relief.r));
}

void main() {
    vec4 stored = texture(colour_map, uv);
    vec4 relief = texture(relief_map, uv);
    float crease = fold * (1.0 - relief.a) / 0.75;
    vec3 diffuse = stored.rgb * stored.rgb * (1.0 - vec3(0.30, 0.42, 0.44) * crease);
    float gloss = stored.a;
    vec3 n = normalize(shading_normal);
    vec3 v = normalize(camera_m - point_m);
    float sky = max(open_sky.x, 0.0), key = max(open_sky.y, 0.0);   // rounding goes below 0, roots do not
    // Shadow is known per vertex for a few expressions only; inside the mouth keep what bounces around.
    if (material_id == 0) { sky = max(sky, 0.12); }
    else if (material_id == 2) { sky = max(sky, 0.62); key = max(key, 0.42); }
    else if (material_id == 1) { sky = max(sky, 0.16); key = max(key, 0.10); }
    else if (material_id == 3) { sky = max(sky, 0.30); key = max(key, 0.12); }
    else if (material_id == 4) { sky = max(sky, 0.34); }
    else if (material_id == 6) { sky = max(sky, 0.22); }
    vec3 nb = bumped(n, relief.r - 0.9 * crease, material_id == 0 ? 0.0008 : (material_id == 6 ? 0.0006 : (material_id == 5 ? 0.0006 : 0.0002)));
    vec3 wrap = relief.g * vec3(0.42, 0.16, 0.08);
    vec3 occluded = pow(vec3(sky), mix(vec3(1.0), vec3(0.72, 1.0, 1.08), relief.g));   // light bleeds red in creases
    vec3 lit = wrapped(nb, key_direction, wrap) * key_light * mix(vec3(key), vec3(sqrt(key), key, key), 0.5 * relief.g)
        + (wrapped(nb, fill_direction, wrap) * fill_light + wrapped(nb, rim_direction, wrap) * rim_light + dome(nb)) * occluded;
    lit *= diffuse;
    if (material_id == 1) {
        // The iris lies behind the cornea and is hollow: the side away from the light is the bright one.
        vec3 hollow = normalize(vec3(-1.6 * n.x, -1.6 * n.y, n.z));
        vec3 deep = wrapped(hollow, key_direction, vec3(0.2)) * key_light * key + (wrapped(hollow, fill_direction, vec3(0.2)) * fill_light + dome(hollow)) * sky;
        lit = mix(lit, diffuse * deep * 0.85, relief.b);
    }
    float grazing = pow(1.0 - max(dot(nb, v), 0.0), 5.0);
    vec3 h = normalize(key_direction + v), hf = normalize(fill_direction + v), hr = normalize(rim_direction + v);
    vec3 shine;
    if (material_id == 1) {
        // Cornea: a sharp picture of softbox and window.
        vec3 r = reflect(-v, n);
        float boxes = smoothstep(0.91, 0.96, dot(r, key_direction)) + 0.05 * smoothstep(-0.2, 0.9, r.y);
        shine = vec3(boxes * (0.335 + 0.6 * grazing) * smoothstep(0.05, 0.5, sky) * 1.4);
    } else if (material_id == 6) {
        strands(nb, strand_tangent, v, relief, diffuse, gloss, sky, key, lit, shine);
        shine *= 0.45;
    } else if (material_id >= 2 && material_id <= 4) {
        float f = 0.045 + 0.5 * grazing;
        shine = vec3(f * gloss * (1.4 * lobe(nb, h, 90.0) * key + 0.5 * lobe(nb, hf, 60.0) * sky)) + f * 0.4 * dome(nb) * sky * gloss;
    } else {
        float f = 0.028 + 0.32 * grazing;
        float broad = lobe(nb, h, 11.0) * key * 0.9 + lobe(nb, hf, 11.0) * sky * 0.30 + lobe(nb, hr, 9.0) * sky * 0.35;
        float tight = lobe(nb, h, 42.0) * key + lobe(nb, hf, 42.0) * sky * 0.35;
        float wet = smoothstep(0.58, 0.95, gloss);
        shine = vec3(f * gloss * (1.5 * broad + 1.1 * tight + 4.0 * wet * lobe(nb, h, 130.0) * key));
        float hair = material_id == 0 ? clamp((0.5 - relief.g) / 0.45, 0.0, 1.0) : 0.0;
        if (hair > 0.0 && dot(strand_tangent, strand_tangent) > 0.01) {   // the raised scalp
            vec3 hair_lit, hair_shine;
            strands(nb, strand_tangent, v, relief, diffuse, gloss, sky, key, hair_lit, hair_shine);
            lit = mix(lit, hair_lit, hair);
            shine = mix(shine, 0.4 * hair_shine, hair);
        }
    }
    vec3 linear = max(lit + shine, 0.0) * 0.92;
    linear = linear * (1.0 + linear * 0.16) / (1.0 + 0.42 * linear);
    vec3 srgb = mix(12.92 * linear, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, linear));
    colour_out = vec4(clamp(srgb, 0.0, 1.0), 1.0);
}
