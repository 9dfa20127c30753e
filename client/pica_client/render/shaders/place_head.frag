// A head from its layer into the image, over what is there.
//
// Where a bust fades it still hides who is behind it, for neighbours who fade at one height would show
// through each other, until little is left of it. How much is left is known row by row, for its nearest
// and its farthest side: what a pixel has less of than the less of them, is not covered. Above, where
// all of it is there, none of this is needed.

in vec2 place; // 0..1 within the rectangle

uniform sampler2D layer; // colours times how much of them is there, and that
uniform vec2 filled; // the part of the layer that the rectangle fills
#ifdef FADING
uniform sampler2D room;
uniform float opacity;
uniform vec4 fading; // rows of the image: nothing is left of one side, all of it is there, of the other

const float HIDING = 3.0;
#endif

layout(location = 0) out vec4 colour;

void main() {
    colour = textureLod(layer, filled * place, 0.0);
#ifdef FADING
    vec3 behind = texelFetch(room, ivec2(gl_FragCoord.xy), 0).rgb;
    float least = smoothstep(fading.x, fading.y, gl_FragCoord.y);
    float most = smoothstep(fading.z, fading.w, gl_FragCoord.y);
    float hides = min(colour.a / max(least, 1e-3), 1.0) * min(HIDING * most, 1.0);
    colour = vec4(opacity * colour.rgb + (hides - opacity * colour.a) * behind, hides);
#endif
}
