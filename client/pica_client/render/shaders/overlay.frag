// A rectangle of text or panel, made by the CPU, colours already multiplied by their alpha.

in vec2 place;

uniform sampler2D image; // row 0 is the top row

layout(location = 0) out vec4 colour;

void main() {
    colour = texture(image, vec2(place.x, 1.0 - place.y));
}
