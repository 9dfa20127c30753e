// The part of a texture that many heads share: tiles of so many rows, one below the other.

const int NUM_TILES = 8;

uniform int tile_heads[NUM_TILES]; // which head of the batch each is of; -1 stays as it is
uniform int tile_rows;

// Which head, and the texel of its map.
ivec3 head_and_texel() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int tile = place.y / tile_rows;
    return ivec3(tile_heads[tile], place.x, place.y - tile * tile_rows);
}
