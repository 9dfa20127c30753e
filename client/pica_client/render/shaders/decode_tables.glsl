// What all passes of the decoder share: the heads of a batch, and the numbers of their avatars.

uniform sampler2D heads; // a row for each head: 64 texels of its latent, its view direction with the
                         // layer of its avatar, and how far a direction of 1 moves vertices
uniform sampler2DArray table; // a layer for each avatar

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
