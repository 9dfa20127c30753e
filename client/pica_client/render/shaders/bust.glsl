// How a head passes into the room: towards its lower border it fades out; a stale one fades as a
// whole. The room lies behind all heads, so no order of drawing is needed.

uniform sampler2D room;
uniform vec3 shown; // height at which nothing is left, height from which all is there, opacity

vec3 before_room(vec3 rgb, vec3 xyz_m) {
    float opacity = shown.z * smoothstep(shown.x, shown.y, xyz_m.y);
    return mix(texelFetch(room, ivec2(gl_FragCoord.xy), 0).rgb, rgb, opacity);
}
