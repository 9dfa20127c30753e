// The vertices of some heads: the mean, and what the directions of each one's region add.

uniform usampler2DArray places; // column in the basis, first row and the one after the last
uniform sampler2DArray mean;
uniform sampler2DArray basis; // signed bytes, from 0 to 1
uniform sampler2D rows; // four directions in a texel, a row for each head

layout(location = 0) out vec4 xyz_m;

#include "decode_tables.glsl"
#include "decode_tiles.glsl"

void main() {
    ivec3 place = head_and_texel();
    if (place.x < 0) {
        discard;
    }
    int head = place.x;
    int avatar = avatar_of(head);
    ivec3 texel = ivec3(place.yz, avatar);
    ivec3 sum = ivec3(texelFetch(places, texel, 0).xyz);
    vec3 moved = vec3(0.0);
    vec4 four = texelFetch(rows, ivec2(sum.y >> 2, head), 0);
    for (int row = sum.y; row < sum.z; ++row) {
        if ((row & 3) == 0) {
            four = texelFetch(rows, ivec2(row >> 2, head), 0);
        }
        vec3 direction = texelFetch(basis, ivec3(sum.x, row, avatar), 0).xyz;
        moved += four[row & 3] * ((255.0 * direction - 128.0) / 127.0);
    }
    float scale_m = texelFetch(heads, ivec2(SCALE, head), 0).x;
    xyz_m = vec4(texelFetch(mean, texel, 0).xyz + scale_m * moved, 1.0);
}
