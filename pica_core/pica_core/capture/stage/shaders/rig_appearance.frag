#version 330
// What each point of a rig without textures is made of. Baked once into two textures:
//   colour  square root of linear diffuse colour; alpha: gloss (0 matt to 1 wet)
//   relief  red: height (bump), green: how much light passes under the surface
// Lengths are millimetres in the head frame at rest.
#include "noise.glsl"
in vec3 rest_mm;
// skin: depth in the lips (0 border, 1 contact), mm to the eye opening, hair coverage, 1 above the eye
// eye: direction from the centre, side.   tongue: 0 root to 1 tip.   mouth lining: mm behind the lips
in vec4 surface;
in vec2 albedo_uv;
const int material_id = MATERIAL;   // a program each: software GL runs every branch
layout(location = 0) out vec4 colour_out;
layout(location = 1) out vec4 relief_out;
uniform float has_albedo;
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

float spot(vec2 p, vec2 centre, vec2 size) { vec2 d = (p - centre) / size; return exp(-0.5 * dot(d, d)); }

// Short strokes that fan from upright at the nose to lying at the temple.
float brow_hair(vec3 p) {
    float u = abs(p.x) - eye_mm.x;
    float s = clamp((u + 20.0) / 45.0, 0.0, 1.0);
    float arch = brow_mm - 1.0 + 4.0 * sin(3.14159 * pow(s, 1.2)) - 6.0 * s * s * s;
    float thick = mix(5.2, 1.7, s * s);
    float d = (p.y - arch) / thick;
    float inside = (1.0 - smoothstep(0.45, 1.25, abs(d))) * smoothstep(-22.0, -13.0, u) * (1.0 - smoothstep(19.0, 26.0, u));
    inside *= step(eye_mm.z - 20.0, p.z);
    vec2 along = normalize(vec2(mix(0.4, 2.6, s), 1.0 - 1.4 * max(d, 0.0) * s));
    vec2 q = vec2(abs(p.x), p.y);
    float strand = noise(vec3(dot(q, vec2(-along.y, along.x)) * 2.1, dot(q, along) * 0.26, seed + sign(p.x) * 5.0));
    return inside * smoothstep(0.30 - 0.2 * inside, 0.66 - 0.2 * inside, strand);
}

void skin(out vec3 rgb, out float gloss, out float height, out float translucent) {
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
    rgb *= mix(vec3(1.0), vec3(1.06, 0.80, 0.78), clamp(blood * (0.75 + 0.6 * fbm(p * 0.09 + seed)), 0.0, 1.2));
    rgb *= mix(vec3(1.0), vec3(0.88, 0.82, 0.85), 0.6 * spot(q, vec2(eye_mm.x - 4.0, eye_mm.y - 13.0), vec2(13.0, 4.5)) * front);
    gloss = 0.34 + 0.20 * spot(p.xy, vec2(0.0, nose_mm.y + 16.0), vec2(11.0, 22.0)) * front
        + 0.12 * spot(p.xy, vec2(0.0, brow_mm + 24.0), vec2(34.0, 18.0)) * front;
    float pores = noise(p * 1.9 + seed) * 0.6 + noise(p * 3.7 + seed) * 0.4;
    float pore_size = 0.4 + 0.8 * max(spot(q, vec2(18.0, nose_mm.y + 4.0), vec2(16.0, 14.0)), spot(p.xy, nose_mm.xy, vec2(14.0, 12.0))) * front;
    height = 0.5 + 0.20 * (pores - 0.5) * pore_size + 0.10 * fine;
    rgb *= 1.0 - 0.10 * pore_size * smoothstep(0.55, 0.25, pores);
    gloss *= 0.75 + 0.5 * pores;
    rgb *= mix(vec3(1.0), vec3(0.55, 0.42, 0.36), 0.7 * spots(p * 0.05 + seed * 3.1, 0.12, 0.05) * front);
    translucent = 0.5;
    // Shadow of a shaved beard.
    float beard = smoothstep(nose_mm.y - 8.0, nose_mm.y - 18.0, p.y) * smoothstep(62.0, 48.0, q.x) * smoothstep(mouth_mm - 75.0, mouth_mm - 45.0, p.y) * front;
    float stubble = smoothstep(0.55, 0.75, noise(p * 4.2 + 3.0));
    rgb *= 1.0 - beard * (0.10 + 0.22 * stubble) * (1.0 - smoothstep(-0.4, 0.0, surface.x));
    // Lids: redder towards the margin, a wet rim, and lashes as a dark line that is stronger above.
    float gap = surface.y;
    rgb *= mix(vec3(1.0), vec3(0.90, 0.76, 0.75), 0.55 * (1.0 - smoothstep(1.0, 9.0, gap)));
    float rim = 1.0 - smoothstep(0.25, 0.9, gap);
    rgb = mix(rgb, vec3(0.48, 0.22, 0.19), 0.75 * rim);
    gloss = mix(gloss, 0.85, rim);
    float above = surface.w;
    float lash = smoothstep(0.2, 0.6, gap) * (1.0 - smoothstep(mix(0.9, 1.5, above), mix(1.5, 2.6, above), gap));
    lash *= 0.75 + 0.25 * noise(vec3(p.x * 2.6, gap * 0.5, seed));
    rgb = mix(rgb, hair_rgb * 0.5, lash * mix(0.35, 0.9, above));
    float crease = exp(-0.5 * pow((gap - 6.0) / 0.8, 2.0)) * above;
    rgb *= 1.0 - 0.12 * crease * step(gap, 20.0);
    // Lips: a soft border, fine upright creases, wet towards the line of contact.
    float d = surface.x + 0.10 * (noise(p * 0.9 + seed) - 0.5);
    float lip = smoothstep(-0.14, 0.16, d);
    float creases = noise(vec3(p.x * 1.5, p.y * 0.22, seed)) * 0.6 + noise(vec3(p.x * 3.1, p.y * 0.4, seed + 1.0)) * 0.4;
    vec3 vermilion = lip_rgb * (0.82 + 0.36 * creases) * mix(vec3(1.0), vec3(0.80, 0.60, 0.60), smoothstep(0.7, 1.25, d));
    rgb = mix(rgb, vermilion, lip);
    gloss = mix(gloss, 0.52 + 0.30 * creases + 0.2 * smoothstep(0.5, 1.0, d), lip);
    height = mix(height, 0.5 + 0.35 * (creases - 0.5), lip);
    float brow = brow_hair(p) * (1.0 - smoothstep(0.05, 0.4, surface.z));
    rgb = mix(rgb, hair_rgb, 0.9 * brow);
    gloss *= 1.0 - 0.4 * brow;
    // Cropped hair: grains that lie back from the crown, over skin that shines through at the edge.
    float grain = noise(p * vec3(1.4, 1.0, 0.6) + seed) * 0.4 + noise(p * vec3(3.1, 2.4, 1.3)) * 0.35 + noise(p * 0.3) * 0.25;
    float cover = smoothstep(-0.15, 0.75, surface.z + 0.5 * (grain - 0.5));
    float hair = cover * mix(smoothstep(0.35, 0.6, grain), 1.0, 0.75 * cover);
    rgb = mix(rgb, hair_rgb * (0.7 + 0.7 * grain), hair);
    gloss = mix(gloss, 0.18, hair);
    height = mix(height, 0.5 + 0.5 * (grain - 0.5), hair);
    translucent *= 1.0 - 0.9 * hair;
}

void eye(out vec3 rgb, out float gloss) {
    vec3 d = normalize(surface.xyz);
    float r = d.z < 0.0 ? 3.0 : length(d.xy) / iris_reach;
    float turn = atan(d.y, d.x);
    vec2 ring = vec2(cos(turn), sin(turn));
    float fibres = fbm(vec3(ring * 9.0, r * 1.4 + seed));
    vec3 iris = iris_rgb * (0.45 + 1.2 * fibres);
    iris = mix(iris, iris * vec3(1.5, 1.15, 0.75), exp(-0.5 * pow((r - 0.48) / 0.10, 2.0)));
    iris *= mix(1.0, 0.35, smoothstep(0.78, 1.0, r));
    iris *= smoothstep(0.36, 0.42, r);
    float vessels = smoothstep(0.60, 0.80, fbm(vec3(d.xy * vec2(9.0, 22.0), seed))) * smoothstep(1.1, 2.0, r);
    vec3 sclera = vec3(0.55, 0.51, 0.48) * (1.0 - 0.06 * noise(d * 4.0));
    sclera = mix(sclera, vec3(0.60, 0.36, 0.31), 0.35 * vessels + 0.30 * smoothstep(1.6, 2.2, r));
    rgb = mix(iris, sclera, smoothstep(0.95, 1.08, r));
    rgb = mix(rgb, vec3(0.46, 0.19, 0.16), smoothstep(0.74, 0.88, -d.x * surface.w));   // caruncle
    gloss = 1.0;
}

void main() {
    vec3 p = rest_mm;
    vec3 rgb = vec3(0.3);
    float gloss = 0.3, height = 0.5, translucent = 0.0;
    if (material_id == 0) {
        skin(rgb, gloss, height, translucent);
    } else if (material_id == 1) {
        eye(rgb, gloss);
    } else if (material_id == 2) {
        rgb = vec3(0.80, 0.73, 0.60) * (0.94 + 0.10 * noise(p * 0.8));
        rgb *= mix(0.45, 1.0, smoothstep(eye_mm.z - 35.0, eye_mm.z + 12.0, p.z));   // far from the light
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
        rgb *= mix(1.0, 0.15, smoothstep(4.0, 40.0, surface.x));   // deeper is darker
        gloss = 0.75;
        height = 0.5 + 0.1 * noise(p);
    } else if (material_id == 5) {
        rgb = vec3(0.05, 0.07, 0.10) * (0.8 + 0.4 * fbm(p * 0.8));
        gloss = 0.1;
    } else {
        float strands = fbm(p * vec3(1.2, 0.3, 1.2) + seed);
        rgb = hair_rgb * (0.35 + 1.4 * strands);
        gloss = 0.4;
        height = strands;
    }
    if (has_albedo > 0.5) rgb = pow(texture(albedo, albedo_uv).rgb, vec3(2.2));
    colour_out = vec4(sqrt(clamp(rgb, 0.0, 1.0)), gloss);
    relief_out = vec4(height, translucent, 0.0, 1.0);
}
