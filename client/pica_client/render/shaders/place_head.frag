// A head from its layer into the image, over what is there. The place comes from the vertices as it is:
// llvmpipe takes a quarter longer where a pixel computes it.

in vec2 place; // within the layer

uniform sampler2D layer; // colours times how much of them is there, and how much of the rest is hidden

layout(location = 0) out vec4 colour;

void main() {
    colour = texture(layer, place);
}
