// A head from its layer into the image, over what is there.

in vec2 place; // 0..1 within the rectangle

uniform sampler2D layer; // colours times how much of them is there, and how much of the rest is hidden
uniform vec2 filled; // the part of the layer that the rectangle fills

layout(location = 0) out vec4 colour;

void main() {
    colour = textureLod(layer, filled * place, 0.0);
}
