// The room, from the few pixels that it is drawn in.

in vec2 place;

uniform sampler2D image;

layout(location = 0) out vec4 colour;

void main() {
    // Half a step of noise against banding: 8 bits are few for so slow a gradient.
    float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
    colour = vec4(textureLod(image, place, 0.0).rgb + (noise - 0.5) / 255.0, 1.0);
}
