// Shapes of the window's surface: triangles in pixels, y down. PLAIN ones have one colour each.

in vec2 place;
in vec4 colour;

uniform vec2 size; // columns and rows of the surface

#ifdef PLAIN
flat out vec4 shape_colour;
#else
in vec2 uv;
out vec2 shape_uv;
out vec4 shape_colour;
#endif

void main() {
#ifndef PLAIN
    shape_uv = uv;
#endif
    shape_colour = colour;
    gl_Position = vec4(2.0 * place.x / size.x - 1.0, 1.0 - 2.0 * place.y / size.y, 0.0, 1.0);
}
