// Shapes of the window's surface: triangles in pixels, y down.

in vec2 place;
in vec2 uv;
in vec4 colour;

uniform vec2 size; // columns and rows of the surface

out vec2 shape_uv;
out vec4 shape_colour;

void main() {
    shape_uv = uv;
    shape_colour = colour;
    gl_Position = vec4(2.0 * place.x / size.x - 1.0, 1.0 - 2.0 * place.y / size.y, 0.0, 1.0);
}
