// The room: a wall in soft light from the upper left, a little lighter behind each of the people, and
// a table that they sit at, whose far edge melts into it where busts have faded, with their shadows. A
// glow stands around whoever speaks. Nothing in it is sharp, so it is drawn small (enlarge.frag).

in vec2 place;

uniform vec4 lens; // slopes of the picture's edges: left, bottom, right, top
uniform mat3 world_from_view; // columns: right, up, forward
uniform vec3 eye_m;
uniform float table_m; // height of the table
uniform int num_seats;
uniform vec4 seats[16]; // those after them are without; middle of the head, metres; how much its owner speaks

layout(location = 0) out vec4 colour;

const vec3 SHADE = vec3(0.178, 0.175, 0.172), LIT = vec3(0.550, 0.538, 0.522); // of the wall
const vec3 GLOW = vec3(0.36, 0.74, 0.55);
const float GLOW_END = 0.0475; // exp(-28 r^2) where a glow ends, 0.33 m from the head
const vec3 LAMP = normalize(vec3(-0.55, 0.40, -1.0));

void main() {
    vec2 slope = mix(lens.xy, lens.zw, place);
    vec3 ray = normalize(world_from_view * vec3(slope, 1.0));
    float light = exp(-2.6 * (1.0 - dot(ray, LAMP)));
    float unlit = 1.0, shadow = 0.0, glow = 0.0;
    for (int index = 0; index < num_seats; ++index) {
        vec3 away = seats[index].xyz - eye_m;
        vec3 past = ray * dot(away, ray) - away; // from the head to where the ray passes it
        float nearness = dot(past, past);
        unlit *= 1.0 - 0.6 * exp(-10.0 * nearness);
        glow = max(glow, seats[index].w * (exp(-28.0 * nearness) - GLOW_END) / (1.0 - GLOW_END));
        vec3 under = (past + vec3(0.0, 0.31, 0.0)) / vec3(0.33, 0.06, 0.33);
        shadow = max(shadow, exp(-dot(under, under)));
    }
    vec3 rgb = mix(SHADE, LIT, 0.75 * light + 0.25 * (1.0 - unlit));
    if (ray.y < 0.0) {
        vec2 at = (eye_m + ray * ((table_m - eye_m.y) / ray.y)).xz;
        float sheen = exp(-1.2 * dot(at - vec2(-0.3, 0.2), at - vec2(-0.3, 0.2)));
        vec3 table = mix(SHADE, LIT, 0.18 + 0.42 * sheen) * vec3(1.0, 0.965, 0.925);
        rgb = mix(rgb, table, smoothstep(-0.30, 0.16, at.y));
    }
    rgb *= 1.0 - 0.35 * shadow;
    rgb = mix(rgb, GLOW, 0.42 * glow);
    vec2 corner = 2.0 * place - 1.0;
    rgb *= 1.0 - 0.10 * dot(corner, corner);
    colour = vec4(rgb, 1.0);
}
