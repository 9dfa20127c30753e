// Which pixels may be near a silhouette: the others are dropped, and these keep the depth of the
// rectangle. A pass of its own because programs are not left early: what is tested here in one
// lookup, a depth test then skips, block by block.
//
// Pixels run in blocks of 2x2: each looks at its corner of the ring around the block, and their
// differences tell the block that no edge is near.

uniform sampler2D image; // alpha says whose a pixel is

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float corner = texelFetch(image, pixel + 2 * (pixel & 1) - 1, 0).a;
    if (dFdx(corner) == 0.0 && dFdy(corner) == 0.0) {
        discard;
    }
}
