#version 330
// What each point of a built-in head is made of. Run once per identity into two textures:
//   colour  square root of linear diffuse colour; alpha: gloss (0 matt to 1 wet)
//   relief  red: height (bump), green: how much light passes under the surface (teeth: how deep in the mouth), blue: strand direction noise
// Lengths are millimetres in the head frame at rest; all chance comes from `seed`.
#include "noise.glsl"
in vec3 rest_mm;
in vec4 surface;
const int material_id = MATERIAL;   // a program each: software GL runs every branch
layout(location = 0) out vec4 colour_out;
layout(location = 1) out vec4 relief_out;
uniform float seed;
uniform vec3 skin_rgb;
uniform float redness;
uniform vec3 lip_rgb;
uniform float freckles;
uniform float stubble;
uniform float beard_cover;
uniform float makeup;
uniform float age;
uniform vec3 brow_rgb;
uniform float brow_thickness;
uniform vec3 iris_rgb;
uniform vec3 cloth_rgb;
uniform vec3 hair_rgb;
uniform float curl;
uniform float sweep;
uniform float grey;
uniform float eye_x;
uniform float brow_y;
uniform float nose_y;   // subnasale
uniform float nose_half;
uniform float mouth_y;
uniform float chin_y;
uniform float upper_lip;
uniform float lower_lip;
uniform float mouth_half;

float bell(float v, float centre, float width) { float d = (v - centre) / width; return exp(-0.5 * d * d); }
float spot(vec2 p, vec2 centre, vec2 size) { vec2 d = (p - centre) / size; return exp(-0.5 * dot(d, d)); }

// Hairs of a brow: short strokes that fan from upright at the nose to lying at the temple.
float brow_hair(vec3 p, out float inside) {
    float u = abs(p.x) - eye_x;
    float s = clamp((u + 21.0) / 47.0, 0.0, 1.0);
    float arch = brow_y + 4.6 * sin(3.14159 * pow(s, 1.25)) * 0.8 - 5.0 * s * s * s;
    float thick = brow_thickness * mix(4.0, 1.5, s * s) * smoothstep(-0.03, 0.12, s);
    float ragged = noise(vec3(p.x * 0.9, p.y * 0.5, seed)) - 0.5;
    float d = (p.y - arch) / max(thick, 0.1) + 0.35 * ragged;
    inside = (1.0 - smoothstep(0.25, 1.25, abs(d)))
        * smoothstep(-25.0, -15.0, u + 3.0 * ragged) * (1.0 - smoothstep(18.0, 28.0, u));
    inside *= step(40.0, p.z) * mix(0.45, 1.0, smoothstep(-24.0, -10.0, u));
    // Hairs are lines of equal `across` in sheared coordinates along the brow.
    float lean = mix(0.55, 2.2, smoothstep(0.0, 0.8, s));
    float rise = p.y - arch;
    float across = (u - lean * rise) * mix(1.5, 0.8, s) + 0.5 * noise(vec3(u * 0.4, rise * 0.4, seed));
    float strand = 0.0;
    for (int k = 0; k < 3; k++) {
        float shift = float(k) * 7.7 + sign(p.x) * 5.0 + seed;
        float line = noise(vec3(across * (1.0 + 0.37 * float(k)), rise * (0.16 + 0.07 * float(k)), shift));
        strand = max(strand, line - 0.03 * float(k));
    }
    float dense = sqrt(inside);
    return smoothstep(0.86 - 0.46 * dense, 1.02 - 0.40 * dense, strand) * smoothstep(0.02, 0.15, inside);
}

void skin(out vec3 rgb, out float gloss, out float height, out float translucent) {
    vec3 p = rest_mm;
    float ax = abs(p.x);
    vec2 q = vec2(ax, p.y);
    float front = smoothstep(20.0, 60.0, p.z);
    bool is_ear = surface.w > 0.5;
    // Colour of skin: melanin varies slowly, blood shows where skin is thin.
    float slow = fbm(p * 0.035 + seed) - 0.5;
    float fine = fbm(p * 0.35 + seed * 1.7) - 0.5;
    rgb = skin_rgb * (1.0 + 0.10 * slow + (0.10 + 0.12 * age) * fine);
    float blood = 0.5 * spot(q, vec2(eye_x + 13.0, -9.0), vec2(16.0, 13.0)) * front
        + 0.6 * spot(vec2(p.x, p.y), vec2(0.0, nose_y + 9.0), vec2(15.0, 9.0)) * front
        + 0.5 * spot(vec2(p.x, p.y), vec2(0.0, chin_y + 14.0), vec2(16.0, 10.0)) * front
        + 0.35 * spot(vec2(p.x, p.y), vec2(0.0, 46.0), vec2(20.0, 9.0)) * front
        + (is_ear ? 0.6 : 0.0);
    blood *= redness * (0.75 + 0.6 * fbm(p * 0.09 + seed));
    rgb *= mix(vec3(1.0), vec3(1.06, 0.80, 0.78), clamp(blood, 0.0, 1.2));
    // Paler, yellower forehead; cooler, darker skin under the eyes.
    rgb *= mix(vec3(1.0), vec3(1.04, 1.03, 0.97), smoothstep(40.0, 70.0, p.y) * front);
    float under_eye = spot(q, vec2(eye_x - 4.0, 10.0), vec2(13.0, 4.5)) * front;
    rgb *= mix(vec3(1.0), vec3(0.88, 0.82, 0.84), (0.30 + 0.5 * age) * under_eye);
    float lid = spot(q, vec2(eye_x, 27.5), vec2(16.0, 5.0)) * front;
    rgb *= mix(vec3(1.0), vec3(0.92, 0.80, 0.80), 0.55 * lid);
    gloss = 0.34 + 0.20 * spot(vec2(p.x, p.y), vec2(0.0, 4.0), vec2(11.0, 22.0)) * front
        + 0.12 * spot(vec2(p.x, p.y), vec2(0.0, 60.0), vec2(34.0, 18.0)) * front;
    // Mottling: skin is never one colour over a centimetre.
    float mottle = fbm(p * 0.16 + seed * 2.3) - 0.5;
    rgb *= 1.0 + vec3(0.06, 0.16, 0.18) * mottle;
    // Pores and fine relief.
    float pores = noise(p * 1.5 + seed) * 0.55 + noise(p * 3.1 + seed) * 0.45;
    float pore_size = 0.45 + 0.9 * max(spot(q, vec2(18.0, -6.0), vec2(16.0, 14.0)),
        spot(vec2(p.x, p.y), vec2(0.0, nose_y + 9.0), vec2(14.0, 12.0))) * front
        + 0.25 * spot(vec2(p.x, p.y), vec2(0.0, chin_y + 16.0), vec2(18.0, 12.0)) * front;
    height = 0.5 + 0.26 * (pores - 0.5) * pore_size + (0.12 + 0.14 * age) * fine;
    rgb *= 1.0 - 0.13 * pore_size * smoothstep(0.52, 0.25, pores);
    gloss *= 0.70 + 0.6 * pores;
    // Freckles and a few moles.
    float place = clamp(spot(q, vec2(26.0, -2.0), vec2(22.0, 14.0)) + 0.25, 0.0, 1.0) * front;
    float marks = spots(p * 0.42 + seed, 0.5 * freckles * place, 0.34);
    rgb *= mix(vec3(1.0), vec3(0.62, 0.50, 0.42), 0.75 * marks);
    float mole = spots(p * 0.040 + seed * 3.1, 0.10, 0.040);
    rgb *= mix(vec3(1.0), vec3(0.42, 0.30, 0.26), mole * front);
    // Lines of the face grow with age: forehead, crow's feet, under the eyes, above the lips.
    float wave = p.y + 1.5 * sin(p.x * 0.09) + 2.0 * noise(vec3(p.x * 0.06, 0.0, seed)) - 62.0;
    float lines = pow(0.5 + 0.5 * cos(wave * 0.72), 14.0) * smoothstep(48.0, 56.0, p.y) * (1.0 - smoothstep(72.0, 84.0, p.y))
        * (1.0 - smoothstep(26.0, 44.0, ax)) * front * smoothstep(0.3, 0.6, noise(vec3(p.x * 0.09, p.y * 0.3, seed + 4.0)));
    vec2 from_corner = q - vec2(eye_x + 13.0, 20.5);
    float ray = atan(from_corner.y, max(from_corner.x, 0.1));
    float feet = pow(0.5 + 0.5 * cos(ray * 11.0 + 1.5 * noise(p * 0.3)), 6.0) * smoothstep(1.5, 5.0, from_corner.x)
        * (1.0 - smoothstep(9.0, 17.0, length(from_corner))) * step(abs(ray), 0.95) * front;
    float crinkle = pow(0.5 + 0.5 * cos((p.y - 0.02 * (ax - eye_x) * (ax - eye_x)) * 1.9 + 3.0 * noise(vec3(p.x * 0.1, p.y * 0.1, seed))), 6.0)
        * spot(q, vec2(eye_x + 2.0, 8.5), vec2(12.0, 4.0)) * front;
    float perioral = pow(0.5 + 0.5 * cos(p.x * 1.25 + 2.0 * noise(p * 0.25)), 8.0)
        * spot(vec2(p.x, p.y), vec2(0.0, mouth_y + 9.0), vec2(17.0, 4.0)) * front;
    float creased = age * age * (1.4 * lines + 1.2 * feet + 0.7 * crinkle + 0.7 * perioral);
    rgb *= 1.0 - vec3(0.20, 0.25, 0.25) * min(creased, 1.0);
    height -= 0.42 * min(creased, 1.2);
    float spots_of_age = spots(p * 0.13 + seed * 5.0, 0.35 * smoothstep(0.5, 1.0, age), 0.16) * front;
    rgb *= mix(vec3(1.0), vec3(0.72, 0.60, 0.50), 0.6 * spots_of_age);
    // Nostrils: their inside is dark.
    float nostril = spot(q, vec2(0.5 * nose_half - 0.2, nose_y + 3.0), vec2(3.0, 2.4)) * step(nose_y - 2.0, p.y) * step(90.0, p.z);
    rgb *= 1.0 - 0.88 * smoothstep(0.30, 0.85, nostril);
    gloss *= 1.0 - smoothstep(0.3, 0.8, nostril);
    translucent = is_ear ? 1.0 : 0.5;
    // Beard shadow.
    float cheek_line = mix(nose_y - 2.0, -4.0, smoothstep(26.0, 62.0, ax));
    float beard = (1.0 - smoothstep(cheek_line - 12.0, cheek_line, p.y + 4.0 * fbm(p * 0.12)))
        * smoothstep(chin_y - 34.0, chin_y - 14.0, p.y) * smoothstep(-8.0, 16.0, p.z);
    beard *= 1.0 - 0.7 * spot(vec2(p.x, p.y), vec2(0.0, mouth_y - 13.0), vec2(20.0, 2.5));
    beard *= 1.0 - 0.55 * bell(ax, mouth_half + 9.0, 6.0) * smoothstep(mouth_y - 16.0, mouth_y, p.y);
    float bristle = smoothstep(0.52, 0.72, noise(vec3(p.x * 4.6, p.y * 3.4, p.z * 4.0) + seed));
    rgb = mix(rgb, mix(rgb * vec3(0.70, 0.71, 0.76), hair_rgb, 0.55 * bristle), stubble * beard * (0.5 + 0.35 * bristle));
    gloss *= 1.0 - 0.5 * stubble * beard;
    // A short full beard: hairs that run down and outwards, sparse at its border.
    float line_y = mix(nose_y - 15.0, nose_y - 2.0, smoothstep(mouth_half + 2.0, mouth_half + 34.0, ax));
    line_y = mix(line_y, 30.0, smoothstep(14.0, 2.0, p.z));   // joins the hair before the ear
    float grow = (1.0 - smoothstep(line_y - 9.0, line_y + 2.0, p.y + 6.0 * fbm(p * 0.2) - 2.0))
        * smoothstep(-15.0, -3.0, p.y + 4.0 * fbm(p * 0.2) - mix(chin_y + 26.0, chin_y, smoothstep(20.0, 88.0, p.z))) * smoothstep(-6.0, 8.0, p.z + 6.0 * fbm(p * 0.25) - 3.0 - 0.12 * min(p.y + 20.0, 0.0));
    float top = nose_y - 5.5 - 0.010 * ax * ax + 2.0 * fbm(p * 0.5);
    float moustache = smoothstep(mouth_y - 3.0, mouth_y + 1.0, p.y) * (1.0 - smoothstep(top - 2.0, top + 1.5, p.y))
        * (1.0 - smoothstep(mouth_half + 2.0, mouth_half + 9.0, ax)) * (1.0 - 0.35 * bell(p.x, 0.0, 1.6));
    grow = max(grow, moustache * front) * (is_ear ? 0.0 : 1.0);
    grow *= 1.0 - smoothstep(0.3, 0.8, spot(vec2(p.x, p.y), vec2(0.0, mouth_y - lower_lip - 4.5), vec2(9.0, 2.0))) * 0.45;
    float lay = noise(vec3((p.x + 0.35 * p.y * sign(p.x)) * 1.7, p.y * 0.35, p.z * 1.1 + seed));
    float fuzz = noise(vec3(p.x * 3.2, p.y * 1.1, p.z * 2.0 + seed));
    float hair_here = smoothstep(0.95 - 0.85 * grow, 1.15 - 0.80 * grow, 0.55 * lay + 0.45 * fuzz + 0.25 * grow) * step(0.02, grow);
    rgb = mix(rgb, hair_rgb * (0.6 + 2.6 * lay * fuzz), beard_cover * max(hair_here, 0.5 * grow * grow));
    height += beard_cover * grow * 0.35 * (0.5 * lay + 0.5 * fuzz - 0.5);
    gloss *= 1.0 - 0.5 * beard_cover * grow;
    // Blush.
    rgb = mix(rgb, rgb * vec3(1.08, 0.74, 0.78), 0.3 * makeup * spot(q, vec2(eye_x + 16.0, -6.0), vec2(14.0, 9.0)) * front);
    // Lips: crisp border with a lighter rim, fine vertical lines, darker towards the line of contact.
    float depth = surface.x + 0.10 * (noise(vec3(p.x * 0.9, p.y * 0.5, seed)) - 0.5);
    float lips = smoothstep(-0.10, 0.12, depth);
    float creases = fbm(vec3(p.x * 1.15 + 0.25 * p.y, p.y * 0.10, seed));
    vec3 lip = lip_rgb * (0.78 + 0.50 * creases);
    lip *= mix(1.0, 0.62, smoothstep(0.55, 1.1, depth));
    lip = mix(lip, lip * vec3(1.15, 0.55, 0.62), makeup * 0.8);
    rgb *= 1.0 + 0.10 * bell(depth, -0.22, 0.12) * front;
    rgb = mix(rgb, lip, lips * (0.85 + 0.1 * makeup));
    rgb = mix(rgb, vec3(0.28, 0.07, 0.065), smoothstep(1.05, 1.7, depth));
    gloss = mix(gloss, 0.62 + 0.25 * makeup - 0.15 * creases, lips);
    height = mix(height, 0.5 + 0.30 * (creases - 0.5), lips);
    // Lid margins: wet pink edge, then lashes as a dense dark line that thins outwards.
    float rows = surface.y;
    float on_edge = 1.0 - smoothstep(0.5, 1.0, abs(rows));
    rgb = mix(rgb, 0.5 * skin_rgb * vec3(1.05, 0.72, 0.70) + vec3(0.14, 0.06, 0.05), on_edge * 0.85);
    gloss = mix(gloss, 0.9, on_edge);
    float upper = clamp(-surface.w, 0.0, 1.0) * (is_ear ? 0.0 : 1.0);
    float comb = noise(vec3(p.x * 3.0, seed, 2.0));
    float reach = mix(1.7, 3.0 + 1.6 * makeup, upper) * (0.65 + 0.6 * comb);
    float lash = smoothstep(0.55, 1.0, abs(rows)) * (1.0 - smoothstep(0.6 * reach, reach, abs(rows)));
    rgb = mix(rgb, brow_rgb * 0.35, lash * mix(0.42, 0.96, upper));
    gloss *= 1.0 - 0.8 * lash;
    float shadow = upper * (1.0 - smoothstep(3.0, 11.0, abs(rows))) * smoothstep(2.0, 4.0, abs(rows));
    rgb = mix(rgb, rgb * vec3(0.60, 0.45, 0.45), 0.55 * makeup * shadow);
    float crease = upper * bell(abs(rows), 9.3, 0.8) * front;
    rgb *= 1.0 - vec3(0.14, 0.20, 0.22) * crease;
    float corner = spot(q, vec2(eye_x - 15.0, 20.5), vec2(1.8, 1.5)) * front;
    rgb = mix(rgb, vec3(0.50, 0.20, 0.17), 0.8 * smoothstep(0.4, 0.9, corner) * (1.0 - smoothstep(2.0, 4.0, abs(rows))));
    // Brows, then scalp hair that fades into the forehead.
    float inside;
    float brow = brow_hair(p, inside);
    rgb = mix(rgb, mix(rgb, brow_rgb, 0.45), inside * 0.8);
    rgb = mix(rgb, brow_rgb * (0.7 + 0.6 * noise(p * 2.0)), brow * 0.92);
    gloss *= 1.0 - 0.6 * brow;
    float density = is_ear ? 0.0 : smoothstep(-0.42, 0.10, surface.z + 0.10 * (noise(p * 0.22 + seed) - 0.5));
    float hairs = noise(vec3(p.x * 2.6, p.y * 0.30, p.z * 2.2) + seed) * 0.6 + noise(vec3(p.x * 4.8, p.y * 0.5, p.z * 4.2) + seed) * 0.4;
    float scalp = smoothstep(0.92 - 0.95 * density, 1.10 - 0.90 * density, hairs) * step(0.004, density);
    scalp = max(scalp, 0.55 * density * density);
    vec3 root_rgb = mix(hair_rgb, vec3(0.24, 0.23, 0.22), 0.8 * grey);
    rgb = mix(rgb, root_rgb * (0.75 + 0.9 * noise(vec3(p.x * 3.0, p.y * 0.4, p.z * 2.0))), 0.94 * scalp);
    gloss *= 1.0 - 0.8 * scalp;
}

void eye(out vec3 rgb, out float gloss, out float height) {
    vec3 d = normalize(surface.xyz);
    float r = length(d.xy) / 0.480;  // iris: 5.8 of 12.1 mm (11.7 mm across: Ruefer et al. 2005)
    r = d.z < 0.0 ? 3.0 : r;
    float turn = atan(d.y, d.x);
    vec2 ring = vec2(cos(turn), sin(turn));
    float fibres = fbm(vec3(ring * 11.0, r * 1.1 + seed));
    float fine = noise(vec3(ring * 34.0, r * 2.0 + seed));
    float crypts = smoothstep(0.55, 0.8, noise(vec3(ring * 5.0, r * 3.5 + seed)));
    vec3 iris = iris_rgb * (0.35 + 1.05 * fibres + 0.35 * fine) * (1.0 - 0.35 * crypts * smoothstep(0.45, 0.7, r));
    iris = mix(iris, iris * vec3(1.55, 1.15, 0.72), bell(r, 0.46, 0.09));   // collarette
    iris *= mix(1.0, 0.22, smoothstep(0.74, 1.0, r));                        // limbal ring
    iris *= smoothstep(0.36, 0.41, r);                                      // pupil
    float vessels = smoothstep(0.58, 0.80, fbm(vec3(d.xy * vec2(9.0, 24.0), seed))) * smoothstep(1.15, 2.0, r);
    vec3 sclera = vec3(0.40, 0.375, 0.36) * (1.0 - 0.08 * noise(d * 4.0));
    sclera = mix(sclera, vec3(0.42, 0.25, 0.21), 0.40 * vessels + 0.30 * smoothstep(1.35, 2.1, r));
    rgb = mix(iris, sclera, smoothstep(0.92, 1.09, r));
    // Nasal end: the caruncle; the skirt around the ball turns pink.
    float nasal = -surface.x * surface.w * 12.1;
    rgb = mix(rgb, vec3(0.36, 0.15, 0.125), smoothstep(11.4, 13.2, nasal));
    rgb = mix(rgb, vec3(0.34, 0.19, 0.16), 0.7 * smoothstep(11.5, 14.5, -nasal));
    gloss = 1.0;
    height = 0.5;
}

void teeth(out vec3 rgb, out float gloss, out float height) {
    float along = abs(surface.x);
    float row = surface.y;
    const float edges[9] = float[9](0.0, 0.125, 0.225, 0.335, 0.445, 0.555, 0.74, 0.92, 1.05);
    float gap = 1.0;
    float inside = 0.5;
    for (int i = 0; i < 8; i++) {
        if (along >= edges[i] && along < edges[i + 1]) {
            inside = (along - edges[i]) / (edges[i + 1] - edges[i]);
            gap = min(along - edges[i], edges[i + 1] - along) * 55.0;
        }
    }
    float gum_line = 0.30 + 0.05 * (1.0 - pow(abs(2.0 * inside - 1.0), 2.0)) - 0.03;
    float tooth = smoothstep(gum_line - 0.012, gum_line + 0.012, row);
    vec3 enamel = mix(vec3(0.78, 0.62, 0.42), vec3(0.86, 0.76, 0.62), smoothstep(0.3, 0.55, row));
    enamel *= mix(0.50, 1.0, smoothstep(0.0, 0.75, gap)) * (0.96 + 0.08 * noise(rest_mm * 0.8));
    enamel *= mix(1.0, 0.16, smoothstep(0.28, 0.75, along));   // far from the light
    vec3 gum = vec3(0.50, 0.17, 0.16) * (0.85 + 0.3 * noise(rest_mm * 0.9));
    rgb = mix(gum, enamel, tooth);
    gloss = 0.85;
    height = 0.5 + 0.1 * noise(rest_mm);
}

void main() {
    vec3 rgb = skin_rgb;
    float gloss = 0.3, height = 0.5, translucent = 0.0, strand = 0.5;
    vec3 p = rest_mm;
    if (material_id == 0) {
        skin(rgb, gloss, height, translucent);
    } else if (material_id == 1) {
        eye(rgb, gloss, height);
    } else if (material_id == 2) {
        teeth(rgb, gloss, height);
        translucent = smoothstep(0.25, 0.62, abs(surface.x));   // how deep in the mouth
    } else if (material_id == 3) {
        float papillae = noise(p * 1.6) * 0.6 + noise(p * 3.1) * 0.4;
        rgb = vec3(0.62, 0.24, 0.21) * (0.75 + 0.5 * papillae);
        rgb *= mix(1.0, 0.75, bell(p.x, 0.0, 1.2)) * mix(0.25, 1.1, smoothstep(0.1, 0.75, surface.x));
        gloss = 0.7;
        height = papillae;
    } else if (material_id == 4) {
        float reach = length(surface.xy * 2.0 - 1.0);
        rgb = vec3(0.24, 0.055, 0.05) * mix(0.2, 1.3, reach * reach);
        gloss = 0.5;
    } else if (material_id == 5) {
        float turn = surface.y * 420.0, rows = surface.x * 34.0;
        float knit = 0.5 + 0.5 * sin(turn * 2.0) * sin(rows * 6.2832);
        rgb = cloth_rgb * (0.7 + 0.45 * knit) * (0.85 + 0.3 * fbm(p * 0.2));
        rgb *= 1.0 - 0.35 * bell(surface.x, 0.13, 0.02);
        gloss = 0.1;
        height = 0.5 + 0.3 * knit;
    } else {
        // Strands run along rows; their place round the head wanders with the curl.
        float azimuth = surface.y * 6.2832;
        float t = surface.x;
        float wander = curl * (0.07 * sin(t * 15.0 + 4.0 * noise(vec3(azimuth * 1.2, 0.0, seed))) + 0.05 * noise(vec3(azimuth * 2.0, t * 3.0, seed)));
        float a = azimuth + wander - sweep * t;
        float coarse = noise(vec3(a * 9.0, t * 1.8, seed));
        float medium = noise(vec3(a * 30.0, t * 2.4, seed + 2.0));
        float thin = noise(vec3(a * 68.0, t * 3.0, seed + 4.0)) * 0.6 + noise(vec3(a * 88.0, t * 4.0, seed + 6.0)) * 0.4;
        float coils = 0.45 * noise(p * 0.42 + seed) + 0.55 * noise(p * 1.15 + seed);
        coils = mix(coils, noise(p * 2.6 + seed), 0.4);
        float coiled = smoothstep(0.7, 0.9, curl);
        float hairs = mix(0.26 * coarse + 0.36 * medium + 0.38 * thin, coils, coiled);
        coarse = mix(coarse, 0.5, coiled);
        medium = mix(medium, noise(p * 1.1 + 5.0), coiled);
        rgb = mix(hair_rgb, hair_rgb * vec3(1.25, 1.1, 0.9), medium) * (0.45 + 1.9 * hairs * hairs);
        rgb = mix(rgb, vec3(0.27, 0.26, 0.25) * (0.55 + 0.75 * hairs), grey * smoothstep(0.75 - 0.6 * grey, 1.05 - 0.6 * grey, 0.75 * thin + 0.25 * medium));
        rgb *= mix(0.8, 1.1, smoothstep(0.0, 0.5, coarse));
        gloss = 0.45 + 0.25 * thin;
        height = hairs;
        strand = medium * 0.5 + thin * 0.5;
    }
    colour_out = vec4(sqrt(clamp(rgb, 0.0, 1.0)), gloss);
    relief_out = vec4(height, translucent, strand, 1.0);
}
