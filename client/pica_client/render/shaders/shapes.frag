// Shapes of the window's surface: glyphs, pictures, and areas, which use a white texel or are PLAIN.

#ifdef PLAIN
flat in vec4 shape_colour;
#else
in vec2 shape_uv;
in vec4 shape_colour;

uniform sampler2D image;
#endif

layout(location = 0) out vec4 colour;

void main() {
#ifdef PLAIN
    colour = shape_colour;
#else
    colour = shape_colour * texture(image, shape_uv);
#endif
}
