// Shapes of the window's surface: glyphs, pictures and plain areas, which use a white texel.

in vec2 shape_uv;
in vec4 shape_colour;

uniform sampler2D image;

layout(location = 0) out vec4 colour;

void main() {
    colour = shape_colour * texture(image, shape_uv);
}
