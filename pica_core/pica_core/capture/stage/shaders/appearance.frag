#version 330
// What each point of a head without textures is made of. Baked once into two textures:
//   colour  square root of linear diffuse colour; alpha: gloss (0 matt to 1 wet)
//   relief  red: height (bump), green: how much light passes under the surface, alpha: 1 to 0.25, how deep a crease skin gets when it folds
// Lengths are millimetres in the head frame at rest.
#include "noise.glsl"
in vec3 rest_mm;
// skin: depth in the lips (0 border, 1 contact), mm to the eye opening, hair coverage, 1 above the eye
// eye: direction from the centre, side.   teeth: 1 at an arch's dark end.   tongue: 0 root to 1 tip.   mouth lining: mm behind the lips
in vec4 surface;
in vec2 albedo_uv;
in vec3 tinted;
in vec3 strand_way;    // direction of hair
const int material_id = MATERIAL;   // a program each: software GL runs every branch
layout(location = 0) out vec4 colour_out;
layout(location = 1) out vec4 relief_out;
uniform float has_albedo;
uniform float over_paint;     // 1: the image lies over what is painted, as opaque as its alpha says
uniform sampler2D albedo;
uniform float seed;
uniform vec3 skin_rgb;
uniform vec3 lip_rgb;
uniform vec3 hair_rgb;
uniform vec3 iris_rgb;
uniform float iris_reach;   // iris radius over eyeball radius
uniform vec3 eye_mm;        // the subject's left eyeball
uniform float brow_mm;
uniform vec3 nose_mm;
uniform float mouth_mm;
uniform float mouth_half;
uniform float has_growth;
uniform vec3 brow_rgb;
uniform vec3 cloth_rgb;
uniform float cloth_knit;
uniform float redness;
uniform float age;          // 0 at twenty years, 1 at seventy-five
uniform float freckles;
uniform float moles;
uniform float makeup;
uniform float grey;
uniform float stubble;
uniform float brows;
uniform float tooth_white;

float spot(vec2 p, vec2 centre, vec2 size) { vec2 d = (p - centre) / size; return exp(-0.5 * dot(d, d)); }

// Streaks along a direction: noise summed up along it.
float streaks(vec3 p, vec3 way, float reach, float fine) {
    float sum = 0.0;
    for (int k = -4; k <= 4; k++) sum += noise((p + way * (reach * float(k) / 4.0)) * fine + seed);
    return clamp(0.5 + (sum / 9.0 - 0.5) * 2.4, 0.0, 1.0);
}
// Strands that have lost their colour lie among the others.
vec3 hair_colour(float strand) {
    vec3 lost = vec3(0.24, 0.235, 0.23);
    return mix(hair_rgb, lost, clamp(grey * (0.75 + 1.1 * (strand - 0.5)), 0.0, 0.92));
}

// Short strokes that fan from upright at the nose to lying at the temple.
float brow_hair(vec3 p, out float inside) {
    float u = abs(p.x) - eye_mm.x;
    float s = clamp((u + 20.0) / 45.0, 0.0, 1.0);
    float arch = brow_mm - 1.0 + 4.0 * sin(3.14159 * pow(s, 1.2)) - 6.0 * s * s * s;
    float thick = brows * mix(4.6, 1.5, s * s);
    float d = (p.y - arch) / thick;
    inside = (1.0 - smoothstep(0.45, 1.25, abs(d))) * smoothstep(-22.0, -13.0, u) * (1.0 - smoothstep(19.0, 26.0, u));
    inside *= step(eye_mm.z - 20.0, p.z);
    vec2 along = normalize(vec2(mix(0.4, 2.6, s), 1.0 - 1.4 * max(d, 0.0) * s));
    vec2 q = vec2(abs(p.x), p.y);
    float strand = noise(vec3(dot(q, vec2(-along.y, along.x)) * 2.1, dot(q, along) * 0.26, seed + sign(p.x) * 5.0));
    return inside * smoothstep(0.30 - 0.2 * inside, 0.66 - 0.2 * inside, strand);
}

void skin(out vec3 rgb, out float gloss, out float height, out float translucent, out float third, out float creased_if_folded) {
    vec3 p = rest_mm;
    float front = smoothstep(eye_mm.z - 50.0, eye_mm.z - 15.0, p.z);
    vec2 q = vec2(abs(p.x), p.y);
    float slow = fbm(p * 0.035 + seed) - 0.5, fine = fbm(p * 0.35 + seed * 1.7) - 0.5;
    rgb = skin_rgb * (1.0 + 0.12 * slow + 0.16 * fine);
    // Blood shows where skin is thin: cheeks, nose, chin, ears.
    float blood = 0.55 * spot(q, vec2(eye_mm.x + 12.0, eye_mm.y - 32.0), vec2(16.0, 13.0)) * front
        + 0.6 * spot(p.xy, nose_mm.xy, vec2(14.0, 10.0)) * front
        + 0.4 * spot(p.xy, vec2(0.0, mouth_mm - 34.0), vec2(16.0, 10.0)) * front
        + 0.6 * smoothstep(72.0, 84.0, q.x) * (1.0 - smoothstep(40.0, 60.0, p.y)) * smoothstep(-60.0, -45.0, p.y);
    rgb *= mix(vec3(1.0), vec3(1.08, 0.74, 0.72), clamp(redness * blood * (0.75 + 0.6 * fbm(p * 0.09 + seed)), 0.0, 1.2));
    // Melanin and blood are mottled; foreheads are paler and yellower.
    float mottle = fbm(p * 0.16 + seed * 2.3) - 0.5, patchy = fbm(p * 0.07 + seed * 4.1) - 0.5;
    rgb *= 1.0 + vec3(0.05, 0.14, 0.16) * mottle * (0.8 + 0.7 * age) + vec3(0.16, 0.17, 0.18) * patchy * (0.5 + age);
    rgb *= mix(vec3(1.0), vec3(1.03, 1.02, 0.95), smoothstep(brow_mm, brow_mm + 30.0, p.y) * front);
    rgb *= mix(vec3(1.0), vec3(0.84, 0.80, 0.88), (0.55 + 0.5 * age) * spot(q, vec2(eye_mm.x - 4.0, eye_mm.y - 13.0), vec2(13.0, 4.5)) * front);
    gloss = 0.34 + 0.20 * spot(p.xy, vec2(0.0, nose_mm.y + 16.0), vec2(11.0, 22.0)) * front
        + 0.12 * spot(p.xy, vec2(0.0, brow_mm + 24.0), vec2(34.0, 18.0)) * front;
    float pores = noise(p * 1.9 + seed) * 0.6 + noise(p * 3.7 + seed) * 0.4;
    float pore_size = 0.4 + 0.8 * max(spot(q, vec2(18.0, nose_mm.y + 4.0), vec2(16.0, 14.0)), spot(p.xy, nose_mm.xy, vec2(14.0, 12.0))) * front;
    height = 0.5 + 0.20 * (pores - 0.5) * pore_size + 0.10 * fine;
    rgb *= 1.0 - 0.10 * pore_size * smoothstep(0.55, 0.25, pores);
    gloss *= 0.75 + 0.5 * pores;
    rgb *= mix(vec3(1.0), vec3(0.55, 0.42, 0.36), spots(p * 0.05 + seed * 3.1, 0.25 * moles, 0.05) * front);
    translucent = 0.5;
    // Freckles; age spots.
    float freckled = clamp(spot(q, vec2(eye_mm.x - 4.0, eye_mm.y - 24.0), vec2(24.0, 14.0)) + 0.2, 0.0, 1.0) * front;
    rgb *= mix(vec3(1.0), vec3(0.62, 0.48, 0.40), 0.7 * spots(p * 0.42 + seed, 0.6 * freckles * freckled, 0.36));
    rgb *= mix(vec3(1.0), vec3(0.74, 0.62, 0.52), 0.6 * spots(p * 0.13 + seed * 5.0, 0.35 * smoothstep(0.55, 1.0, age), 0.16));
    // Lines that grow with age: forehead, crow's feet, under the eyes, from nose to mouth, over the lips, on the neck.
    float wave = p.y + 1.5 * sin(p.x * 0.09) + 2.5 * noise(vec3(p.x * 0.06, 0.0, seed)) - brow_mm - 14.0;
    float lines = pow(0.5 + 0.5 * cos(wave * 0.74), 14.0) * smoothstep(2.0, 8.0, wave) * (1.0 - smoothstep(24.0, 34.0, wave))
        * (1.0 - smoothstep(26.0, 44.0, q.x)) * front * smoothstep(0.3, 0.6, noise(vec3(p.x * 0.09, p.y * 0.3, seed + 4.0)));
    vec2 corner = q - vec2(eye_mm.x + 14.0, eye_mm.y - 1.0);
    float ray = atan(corner.y, max(corner.x, 0.1));
    float feet = pow(0.5 + 0.5 * cos(ray * 11.0 + 1.5 * noise(p * 0.3)), 6.0) * smoothstep(1.5, 5.0, corner.x)
        * (1.0 - smoothstep(9.0, 18.0, length(corner))) * step(abs(ray), 0.95) * smoothstep(eye_mm.z - 60.0, eye_mm.z - 30.0, p.z);
    float bag = pow(0.5 + 0.5 * cos((p.y - eye_mm.y - 0.02 * pow(q.x - eye_mm.x, 2.0)) * 1.7 + 3.0 * noise(vec3(p.x * 0.1, p.y * 0.1, seed))), 6.0)
        * spot(q, vec2(eye_mm.x + 1.0, eye_mm.y - 14.0), vec2(12.0, 5.0)) * front;
    float fold_x = mix(14.0, mouth_half + 7.0, smoothstep(nose_mm.y - 2.0, mouth_mm - 4.0, p.y));
    fold_x = 17.0 + (mouth_half - 9.0) * smoothstep(nose_mm.y, mouth_mm - 8.0, p.y);
    float fold = exp(-0.5 * pow((q.x - fold_x) / 1.3, 2.0)) * smoothstep(nose_mm.y + 2.0, nose_mm.y - 8.0, p.y) * smoothstep(mouth_mm - 14.0, mouth_mm - 2.0, p.y) * front;
    float perioral = pow(0.5 + 0.5 * cos(p.x * 1.25 + 2.0 * noise(p * 0.25)), 8.0) * spot(p.xy, vec2(0.0, mouth_mm + 11.0), vec2(17.0, 4.0)) * front;
    float neck = pow(0.5 + 0.5 * cos(p.y * 0.42 + 2.5 * noise(p * 0.03 + seed)), 12.0) * smoothstep(mouth_mm - 55.0, mouth_mm - 70.0, p.y);
    float frown = exp(-0.5 * pow((q.x - 5.5 - 0.15 * (p.y - brow_mm)) / 1.1, 2.0)) * spot(p.xy, vec2(0.0, brow_mm + 1.0), vec2(14.0, 8.0)) * front;
    float cheek = exp(-0.5 * pow((q.x - fold_x - 8.0) / 1.4, 2.0)) * spot(p.xy, vec2(sign(p.x) * (mouth_half + 12.0), mouth_mm + 4.0), vec2(16.0, 13.0)) * front;
    creased_if_folded = clamp(lines + frown + feet + 0.8 * bag + fold + 0.6 * cheek + 0.5 * perioral + 0.8 * neck, 0.0, 1.0);
    float creased = age * age * (1.3 * lines + 1.1 * feet + 0.8 * bag + 0.7 * perioral) + 0.8 * age * fold + 0.5 * age * neck;
    rgb *= 1.0 - vec3(0.17, 0.22, 0.22) * min(creased, 1.0);
    height -= 0.40 * min(creased, 1.2) + 0.12 * age * (noise(p * 0.9 + seed) - 0.5);
    // Shadow of a shaved beard, or stubble.
    float shaved = smoothstep(nose_mm.y - 8.0, nose_mm.y - 18.0, p.y + 0.12 * q.x * step(q.x, 40.0)) * smoothstep(66.0, 50.0, q.x) * smoothstep(mouth_mm - 72.0, mouth_mm - 48.0, p.y) * front;
    float bristle = smoothstep(0.52, 0.74, noise(p * vec3(4.4, 3.6, 4.0) + 3.0));
    float no_lip = 1.0 - smoothstep(-0.4, 0.0, surface.x);
    rgb = mix(rgb, mix(rgb * vec3(0.74, 0.76, 0.80), hair_colour(bristle), 0.6 * bristle), stubble * shaved * no_lip * (0.35 + 0.4 * bristle));
    gloss *= 1.0 - 0.4 * stubble * shaved;
    // Blush.
    rgb = mix(rgb, rgb * vec3(1.06, 0.76, 0.80), 0.35 * makeup * spot(q, vec2(eye_mm.x + 14.0, eye_mm.y - 28.0), vec2(14.0, 9.0)) * front);
    // Lids: redder towards the margin, a wet rim, and lashes as a dark line that is stronger above.
    float gap = surface.y;
    rgb *= mix(vec3(1.0), vec3(0.90, 0.76, 0.75), 0.55 * (1.0 - smoothstep(1.0, 9.0, gap)));
    float rim = 1.0 - smoothstep(0.25, 0.9, gap);
    rgb = mix(rgb, vec3(0.48, 0.22, 0.19), 0.75 * rim);
    gloss = mix(gloss, 0.85, rim);
    float above = surface.w;
    float lash = smoothstep(0.2, 0.6, gap) * (1.0 - smoothstep(mix(0.7, 1.0, above), mix(1.3, 2.1, above), gap));
    lash *= (0.75 + 0.25 * noise(vec3(p.x * 2.6, gap * 0.5, seed))) * smoothstep(eye_mm.x - 13.0, eye_mm.x - 7.0, q.x);
    rgb = mix(rgb, min(brow_rgb, vec3(0.05)) * 0.4, lash * mix(0.35 + 0.2 * makeup, 0.95, above));
    float shadow = above * smoothstep(1.5, 3.0, gap) * (1.0 - smoothstep(5.0, 10.0, gap));
    rgb = mix(rgb, rgb * vec3(0.62, 0.48, 0.48), 0.5 * makeup * shadow);
    float crease = exp(-0.5 * pow((gap - 6.0) / 0.8, 2.0)) * above;
    rgb *= 1.0 - 0.12 * crease * step(gap, 20.0);
    // Lips: a soft border, fine upright creases, wet towards the line of contact.
    float d = surface.x + 0.10 * (noise(p * 0.9 + seed) - 0.5);
    float lip = smoothstep(-0.14, 0.16, d);
    float creases = noise(vec3(p.x * 1.5, p.y * 0.22, seed)) * 0.6 + noise(vec3(p.x * 3.1, p.y * 0.4, seed + 1.0)) * 0.4;
    vec3 vermilion = lip_rgb * (0.82 + 0.36 * creases) * mix(vec3(1.0), vec3(0.80, 0.60, 0.60), smoothstep(0.7, 1.25, d));
    vermilion = mix(vermilion, vermilion * vec3(1.10, 0.50, 0.58), 0.9 * makeup);
    rgb *= 1.0 + 0.07 * exp(-0.5 * pow((d + 0.22) / 0.12, 2.0)) * front;
    rgb = mix(rgb, vermilion, lip * (0.86 + 0.14 * makeup));
    gloss = mix(gloss, 0.52 + 0.30 * creases + 0.2 * smoothstep(0.5, 1.0, d), lip);
    height = mix(height, 0.5 + 0.35 * (creases - 0.5), lip);
    float inside, brow = brow_hair(p, inside) * (1.0 - smoothstep(0.05, 0.4, surface.z));
    rgb = mix(rgb, mix(rgb, brow_rgb, 0.6), inside * has_growth);
    rgb = mix(rgb, brow_rgb * (0.7 + 0.6 * noise(p * 2.0)), 0.88 * brow);
    gloss *= 1.0 - 0.4 * brow;
    // Hair on the scalp, strands along their direction; skin shines through at the edge. Without one: cropped grains.
    float c = surface.z, dense, tone;
    if (has_growth > 0.5) {
        vec3 way = normalize(strand_way + 1e-4);
        float fine = streaks(p, way, 3.2, 1.9), wide = streaks(p, way, 11.0, 0.7);
        tone = 0.6 * fine + 0.4 * wide;
        float locks = streaks(p, way, 16.0, 0.26);
        float ragged = 0.8 * (fine - 0.5) + 0.6 * (wide - 0.5) + 0.9 * (locks - 0.5);
        tone = clamp(tone + 0.45 * (locks - 0.5), 0.0, 1.0);
        float scalp = smoothstep(-0.55, 0.6, c + ragged) * smoothstep(-0.75, -0.25, c);   // strands thin out, skin shines through
        dense = scalp * mix(smoothstep(0.30, 0.62, fine + 0.35 * scalp), 1.0, scalp);
        rgb = mix(rgb, mix(rgb, hair_rgb, 0.45), smoothstep(-0.9, 0.3, c));
        float stray = smoothstep(0.12, 0.92, 0.6 * ragged);   // single hairs, down
        dense = max(dense, stray * mix(smoothstep(0.3, 0.5, fine + 0.25 * stray), 1.0, 0.6 * stray));
    } else {
        tone = noise(p * vec3(1.4, 1.0, 0.6) + seed) * 0.4 + noise(p * vec3(3.1, 2.4, 1.3)) * 0.35 + noise(p * 0.3) * 0.25;
        float cover = smoothstep(-0.15, 0.75, c + 0.5 * (tone - 0.5));
        dense = cover * mix(smoothstep(0.35, 0.6, tone), 1.0, 0.75 * cover);
    }
    float hair = dense;
    third = mix(0.5, tone, hair);
    rgb = mix(rgb, hair_colour(tone) * (0.35 + 1.3 * tone), hair);
    gloss = mix(gloss, 0.20, hair);
    height = mix(height, 0.5 + 0.7 * (tone - 0.5), hair);
    translucent *= 1.0 - 0.9 * hair;
}

void eye(out vec3 rgb, out float gloss, out float inside) {
    vec3 d = normalize(surface.xyz);
    float r = d.z < 0.0 ? 3.0 : length(d.xy) / iris_reach;
    float turn = atan(d.y, d.x);
    vec2 ring = vec2(cos(turn), sin(turn));
    float fibres = fbm(vec3(ring * 11.0, r * 1.1 + seed)), fine = noise(vec3(ring * 34.0, r * 2.0 + seed));
    float crypts = smoothstep(0.55, 0.8, noise(vec3(ring * 5.0, r * 3.5 + seed)));
    vec3 iris = iris_rgb * (0.20 + 1.50 * fibres + 0.50 * fine) * (1.0 - 0.35 * crypts * smoothstep(0.45, 0.7, r));
    iris = mix(iris, iris * vec3(1.55, 1.15, 0.75), exp(-0.5 * pow((r - 0.46) / 0.09, 2.0)));   // collarette
    iris *= mix(1.0, 0.10, smoothstep(0.66, 0.98, r));   // limbal ring
    iris *= smoothstep(0.33, 0.39, r);                  // pupil
    float vessels = smoothstep(0.58, 0.80, fbm(vec3(d.xy * vec2(9.0, 24.0), seed))) * smoothstep(1.15, 2.0, r);
    vec3 sclera = vec3(0.43, 0.39, 0.355) * (1.0 - 0.06 * noise(d * 4.0)) * mix(vec3(1.0), vec3(0.96, 0.92, 0.82), 0.6 * age);
    sclera = mix(sclera, vec3(0.52, 0.30, 0.25), (0.28 + 0.25 * age) * vessels + 0.26 * smoothstep(1.45, 2.15, r));
    sclera *= mix(1.0, 0.62, smoothstep(1.15, 2.1, abs(d.x) / iris_reach));   // rounds away into the corners
    rgb = mix(iris, sclera, smoothstep(0.93, 1.09, r));
    rgb = mix(rgb, vec3(0.40, 0.17, 0.14), smoothstep(0.74, 0.88, -d.x * surface.w));   // caruncle
    gloss = 1.0;
    inside = 1.0 - smoothstep(0.90, 1.02, r);
}

void main() {
    vec3 p = rest_mm;
    vec3 rgb = vec3(0.3);
    float gloss = 0.3, height = 0.5, translucent = 0.0, third = 0.5, folds = 0.0;
    if (material_id == 0) {
        skin(rgb, gloss, height, translucent, third, folds);
    } else if (material_id == 1) {
        eye(rgb, gloss, third);
    } else if (material_id == 2) {
        rgb = mix(vec3(0.84, 0.72, 0.53), vec3(0.92, 0.85, 0.73), tooth_white) * (0.94 + 0.10 * noise(p * 0.8));
        rgb *= mix(0.30, 1.0, smoothstep(eye_mm.z - 22.0, eye_mm.z + 8.0, p.z));   // far from the light
        rgb *= mix(vec3(1.0), vec3(0.52, 0.42, 0.36), smoothstep(9.0, 26.0, abs(p.x)));
        rgb *= 1.0 - 0.85 * surface.x;
        gloss = 0.85;
        height = 0.5 + 0.1 * noise(p);
    } else if (material_id == 3) {
        float papillae = noise(p * 1.6) * 0.6 + noise(p * 3.1) * 0.4;
        rgb = vec3(0.48, 0.17, 0.16) * (0.75 + 0.5 * papillae) * mix(1.0, 0.72, exp(-0.5 * pow(p.x / 1.2, 2.0)));
        rgb *= mix(0.25, 1.1, smoothstep(0.1, 0.8, surface.x));
        gloss = 0.7;
        height = papillae;
    } else if (material_id == 4) {
        rgb = vec3(0.46, 0.16, 0.15) * (0.85 + 0.3 * noise(p * 0.9));
        rgb *= mix(vec3(1.0), vec3(0.42, 0.30, 0.30), smoothstep(4.0, 40.0, surface.x));   // deeper is darker
        gloss = 0.75;
        height = 0.5 + 0.1 * noise(p);
    } else if (material_id == 5) {
        // Cloth: a fine weave, or a knit of upright ribs; worn a little.
        float weave = 0.5 + 0.25 * sin(albedo_uv.x * 2800.0) * sin(albedo_uv.y * 2800.0);
        float knit = 0.5 + 0.5 * sin(albedo_uv.x * 1150.0 + 0.6 * sin(albedo_uv.y * 1600.0));
        float cloth = mix(weave, knit, cloth_knit);
        rgb = cloth_rgb * (0.86 + 0.22 * fbm(p * 0.12 + seed)) * (0.80 + 0.30 * cloth);
        gloss = 0.10;
        height = 0.5 + 0.30 * (cloth - 0.5) + 0.25 * (fbm(p * 0.06 + seed) - 0.5);
    } else {
        // A lock: strands run along it, darker at the root and between.
        float along = surface.x, number = floor(surface.z + 0.5) + seed, reach = 1000.0 * surface.w;
        vec2 at = vec2(albedo_uv.x * 1000.0, along * reach);
        at.x += 2.5 * sin(at.y * 0.05 + 5.0 * noise(vec3(at.x * 0.03, number, seed))) * along;
        float broad = noise(vec3(at.x * 0.11, at.y * 0.010, seed)), wide = noise(vec3(at.x * 0.45, at.y * 0.014, number + 3.0));
        float fine = noise(vec3(at.x * 1.5, at.y * 0.025, number)), thin = noise(vec3(at.x * 3.4, at.y * 0.04, number + 7.0));
        float hairs = clamp(0.5 + 1.5 * (0.22 * broad + 0.30 * wide + 0.28 * fine + 0.20 * thin - 0.5), 0.0, 1.0);
        rgb = hair_colour(0.5 * fine + 0.5 * thin) * mix(vec3(0.90, 0.95, 1.0), vec3(1.18, 1.06, 0.95), broad) * (0.32 + 1.3 * hairs);
        rgb *= mix(1.0, 1.12, along);
        gloss = 0.30 + 0.30 * thin;
        height = hairs;
        third = 0.5 * fine + 0.5 * thin;
    }
    if (has_albedo > 0.5) {
        vec4 image = texture(albedo, albedo_uv);
        rgb = mix(rgb, pow(image.rgb, vec3(2.2)) * tinted, mix(1.0, image.a, over_paint));
    }
    colour_out = vec4(sqrt(clamp(rgb, 0.0, 1.0)), gloss);
    relief_out = vec4(height, translucent, third, 1.0 - 0.75 * folds);
}
