// One vertex of a head: its UV is fixed; where it is comes out of what was decoded, or is given.

#ifdef MAPPED
in vec2 vertex_place; // where to look its position up: its UV in a position map, its slot in a sheet

uniform sampler2D position_map; // head-frame metres
#else
in vec3 vertex_xyz_m;
in float vertex_opacity;

out float surface_opacity;

// A static surface counts as so much nearer: below its seam lies the decoded one, in a finer mesh.
const float NEARER_M = 0.002;
#endif
in vec2 vertex_uv;

uniform mat4 clip_from_head;
uniform vec3 box_m[2]; // two corners of the box that the avatar promised to stay in

out vec2 surface_uv;
out vec3 surface_xyz_m;

// Lookups by texelFetch, for textures that a sampler may not filter: 32-bit float ones are not
// filterable in GLSL ES 3.00. Texel centres at (i + 0.5) / size, clamped to the edge.
vec4 fetch_bilinear(sampler2D image, vec2 uv) {
    ivec2 last = textureSize(image, 0) - 1;
    vec2 place = uv * vec2(last + 1) - 0.5;
    vec2 corner = floor(place);
    vec2 weight = place - corner;
    ivec2 low = clamp(ivec2(corner), ivec2(0), last);
    ivec2 high = clamp(ivec2(corner) + 1, ivec2(0), last);
    vec4 upper = mix(texelFetch(image, low, 0), texelFetch(image, ivec2(high.x, low.y), 0), weight.x);
    vec4 lower = mix(texelFetch(image, ivec2(low.x, high.y), 0), texelFetch(image, high, 0), weight.x);
    return mix(upper, lower, weight.y);
}

void main() {
#ifdef MAPPED
    vec3 xyz_m = fetch_bilinear(position_map, vertex_place).xyz;
#else
    vec3 xyz_m = vertex_xyz_m;
#endif
    // What is no number fails every comparison, and falls to the origin: a broken map must not reach
    // over the screen and hide its neighbours.
    bool is_sound = all(lessThan(abs(xyz_m), vec3(1e6)));
    surface_xyz_m = clamp(is_sound ? xyz_m : vec3(0.0), box_m[0], box_m[1]);
    surface_uv = vertex_uv;
    gl_Position = clip_from_head * vec4(surface_xyz_m, 1.0);
#ifndef MAPPED
    surface_opacity = vertex_opacity;
    // The distance from the far plane grows as the depth shrinks, and with it the depth buffer.
    float away_m = max(gl_Position.w, 1e-3);
    gl_Position.z = gl_Position.w - (gl_Position.w - gl_Position.z) * (away_m + NEARER_M) / away_m;
#endif
}
