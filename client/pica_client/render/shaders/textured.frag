// A surface with a texture: a baseline avatar, or what of another does not change with the face.

in vec2 surface_uv;
in vec3 surface_xyz_m;
#ifdef STATIC
in float surface_opacity;
#endif

uniform sampler2D skin; // row 0 is v = 0
#ifdef STATIC
#endif

layout(location = 0) out vec4 colour;

#include "pixels.glsl"

void main() {
#ifdef STATIC
    // At its seam it takes turns with the decoded surface below, and where two levels are mixed
    // they with each other.
    float turn = turn_of_pixel();
    if (surface_opacity <= fract(turn + 0.5) || turn < turns.x || turn >= turns.y) {
        discard;
    }
#endif
    colour = presence(surface_xyz_m) * vec4(textureLod(skin, surface_uv, 0.0).rgb, 1.0);
}
