// An image of many channels, in four textures: one for each place within a block of 2 x 2 texels.
// Groups of four channels lie side by side, heads one below the other.

uniform sampler2D phase0; // even columns of even rows
uniform sampler2D phase1; // odd columns of even rows
uniform sampler2D phase2;
uniform sampler2D phase3;
