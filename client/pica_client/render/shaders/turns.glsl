// A number from 0 to 1 for each pixel of the image, spread evenly over neighbours: two surfaces that
// give way to one another take turns by it.

uniform vec2 corner; // of the layer, in the image

float turn_of_pixel() {
    return fract(52.9829189 * fract(dot(floor(gl_FragCoord.xy) + corner, vec2(0.06711056, 0.00583715))));
}
