// A quiet room: a lit wall, a darker floor that fades in, and corners that fall off a little.

in vec2 place;

uniform float aspect;

layout(location = 0) out vec4 colour;

void main() {
    vec2 centred = (place - vec2(0.5, 0.62)) * vec2(aspect, 1.0);
    float light = exp(-1.6 * dot(centred, centred));
    vec3 wall = mix(vec3(0.105, 0.125, 0.16), vec3(0.30, 0.335, 0.385), light);
    float floor_amount = smoothstep(0.30, 0.02, place.y);
    vec3 room = mix(wall, vec3(0.085, 0.085, 0.095), 0.75 * floor_amount);
    // Half a step of noise against banding: 8 bits are few for so slow a gradient.
    float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
    room += (noise - 0.5) / 255.0;
    colour = vec4(room, 1.0);
}
