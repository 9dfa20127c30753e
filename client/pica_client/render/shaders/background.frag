// The room: a wall that is lit behind the people, a floor that runs up into it without an edge, a
// shadow under each of them, and a ring of light around whoever speaks. Nothing in it is sharp, so it
// is drawn small (enlarge.frag).

in vec2 place;

uniform vec4 lens; // slopes of the picture's edges: left, bottom, right, top
uniform mat3 world_from_view; // columns: right, up, forward
uniform vec3 eye_m;
uniform float floor_m; // height of the floor
uniform float ring_m; // radius of the rings
uniform int num_seats;
uniform vec4 seats[16]; // those after them are without; middle of the head, metres; how much its owner speaks

layout(location = 0) out vec4 colour;

const vec3 WALL_DARK = vec3(0.098, 0.116, 0.140);
const vec3 WALL_LIT = vec3(0.392, 0.416, 0.436);
const vec3 FLOOR_DARK = vec3(0.120, 0.124, 0.132);
const vec3 FLOOR_LIT = vec3(0.318, 0.312, 0.304);
const vec3 RING = vec3(0.36, 0.70, 0.54);
const vec3 LIGHT_M = vec3(0.0, 0.15, -1.6); // middle of the lit part of the wall
const float SHADOW_M = -0.40; // below the middle of the head

void main() {
    vec2 slope = mix(lens.xy, lens.zw, place);
    vec3 ray = normalize(world_from_view * vec3(slope, 1.0));
    float facing = dot(ray, normalize(LIGHT_M - eye_m));
    vec3 rgb = mix(WALL_DARK, WALL_LIT, exp(-9.0 * (1.0 - facing)));
    if (ray.y < 0.0) {
        vec2 at = (eye_m + ray * ((floor_m - eye_m.y) / ray.y)).xz;
        vec2 off = vec2(0.5 * at.x, max(at.y - 0.1, 0.0));
        vec3 ground = mix(FLOOR_DARK, FLOOR_LIT, exp(-dot(off, off)));
        rgb = mix(rgb, ground, smoothstep(2.2, 0.0, -at.y));
    }
    for (int index = 0; index < num_seats; ++index) {
        vec3 away = seats[index].xyz - eye_m;
        float reach = (away.y + SHADOW_M) / ray.y;
        vec2 aside = reach > 0.0 ? (ray * reach - away).xz : vec2(1e3);
        // None where the ground would be seen from its edge: under the upper rows of a grid.
        float depth = 0.4 * smoothstep(0.06, 0.16, -ray.y);
        rgb *= 1.0 - depth * exp(-dot(aside, aside) / 0.05);
        // How far the ray passes from a point a little below the middle of the head.
        float past = length(cross(away - vec3(0.0, 0.04, 0.0), ray));
        float ring = exp(-pow((past - ring_m) / 0.014, 2.0)) + 0.4 * exp(-past * past / 0.07);
        // Around a large face a little is enough.
        float bright = 0.5 * smoothstep(0.2, 1.7, length(away));
        rgb = mix(rgb, RING, bright * seats[index].w * min(ring, 1.0));
    }
    vec2 corner = 2.0 * place - 1.0;
    rgb *= 1.0 - 0.16 * dot(corner, corner);
    colour = vec4(rgb, 1.0);
}
