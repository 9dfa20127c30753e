// A rectangle of the screen, without a vertex buffer: draw a triangle strip of 4.

uniform vec4 rect; // left, bottom, right, top in clip space

#ifdef FILLED
uniform vec2 filled; // the part of a texture that the rectangle fills
#endif

out vec2 place; // 0..1 within the rectangle, from its lower left; or within the texture

void main() {
    place = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    // At the far plane: a depth test for "behind something" finds the pixels that heads cover.
    gl_Position = vec4(mix(rect.xy, rect.zw, place), 1.0, 1.0);
#ifdef FILLED
    place *= filled;
#endif
}
