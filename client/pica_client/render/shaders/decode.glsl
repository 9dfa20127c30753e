// What the passes of the decoder share. The heads of a batch lie one below the other in its images, and
// an image of many channels is four textures, one for each place within a block of 2 x 2 texels, with
// groups of four channels side by side.

uniform sampler2D heads; // a row for each head: 64 texels of its latent, its view direction with the
                         // layer of its avatar, and how far a direction of 1 moves vertices
uniform sampler2DArray table; // the numbers of avatars, a layer for each
uniform sampler2D phase0; // even columns of even rows
uniform sampler2D phase1; // odd columns of even rows
uniform sampler2D phase2;
uniform sampler2D phase3;

const int VIEW = 64;
const int SCALE = 65;

vec4 number(int place, int avatar) {
    return texelFetch(table, ivec3(place & 1023, place >> 10, avatar), 0);
}

mat4 block(int place, int avatar) {
    return mat4(
        number(place, avatar), number(place + 1, avatar), number(place + 2, avatar), number(place + 3, avatar)
    );
}

int avatar_of(int head) {
    return int(texelFetch(heads, ivec2(VIEW, head), 0).w);
}

// A place of one of the four textures: 1 is an odd column, 2 an odd row.
vec4 read_phase(int odd, ivec2 place) {
    if (odd < 2) {
        return odd == 0 ? texelFetch(phase0, place, 0) : texelFetch(phase1, place, 0);
    }
    return odd == 2 ? texelFetch(phase2, place, 0) : texelFetch(phase3, place, 0);
}

// One texel of an image whose tile begins at a place.
vec4 read_texel(ivec2 texel, ivec2 tile) {
    return read_phase(2 * (texel.y & 1) + (texel.x & 1), tile + (texel >> 1));
}

vec4 leaky(vec4 value) {
    return max(value, 0.2 * value);
}
