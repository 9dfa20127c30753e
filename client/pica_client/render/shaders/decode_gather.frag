// The expression maps of some heads, out of the four phases of all heads' maps.

layout(location = 0) out vec4 value;

#include "decode.glsl"

void main() {
    ivec3 place = head_and_texel();
    if (place.x < 0) {
        discard;
    }
    value = read_texel(place.yz, ivec2(0, tile_rows / 2 * place.x));
}
