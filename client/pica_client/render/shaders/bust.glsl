// How a head passes into the room: towards its lower border it fades out.

uniform vec2 shown; // height at which nothing is left, height from which all is there

float presence(vec3 xyz_m) {
    return smoothstep(shown.x, shown.y, xyz_m.y);
}
