#version 330
// Mean of each pixel's samples, halves rounded up, with the top row first.
out vec4 mean_out;
uniform sampler2D samples;   // row 0 is the bottom row
uniform int side;            // samples per pixel along each axis
void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int rows = textureSize(samples, 0).y / side;
    ivec2 first = side * ivec2(pixel.x, rows - 1 - pixel.y);
    ivec3 total = ivec3(side * side / 2);
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++)
            total += ivec3(255.0 * texelFetch(samples, first + ivec2(x, y), 0).rgb + 0.5);
    mean_out = vec4(vec3(total / (side * side)) / 255.0, 1.0);
}
