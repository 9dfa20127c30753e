// How a head passes into the room: towards its lower border it fades out, at the shoulders a little
// earlier than in the middle; a stale one fades as a whole. The room lies behind all heads, so no
// order of drawing is needed.

uniform sampler2D room;
uniform vec3 shown; // height at which nothing is left, height from which all is there, opacity

const float BEND = 0.9; // metres of height for each square metre aside

vec3 before_room(vec3 rgb, vec3 xyz_m) {
    float height = xyz_m.y - BEND * xyz_m.x * xyz_m.x;
    float opacity = shown.z * smoothstep(shown.x, shown.y, height);
    return mix(texelFetch(room, ivec2(gl_FragCoord.xy), 0).rgb, rgb, opacity);
}
