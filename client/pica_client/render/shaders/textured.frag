// A surface with a texture: what of an avatar does not change with the face, or a head without a decoder.

in vec2 surface_uv;
in vec3 surface_xyz_m;
uniform sampler2D skin; // row 0 is v = 0
in float surface_opacity;

uniform vec2 corner; // of the layer in the image

layout(location = 0) out vec4 colour;

#include "pixels.glsl"

void main() {
    // At its seam it takes turns with the decoded surface below: by a number from 0 to 1 for each
    // pixel of the image, spread evenly over neighbours.
    vec2 pixel = floor(gl_FragCoord.xy) + corner;
    float turn = fract(52.9829189 * fract(dot(pixel, vec2(0.06711056, 0.00583715))));
    if (surface_opacity <= turn) {
        discard;
    }
    colour = presence(surface_xyz_m) * vec4(textureLod(skin, surface_uv, 0.0).rgb, 1.0);
}
