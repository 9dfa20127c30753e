// One head's vertices: the mean, and what the directions of each one's region add.

uniform usampler2D places; // column in the basis, first row and the one after the last
uniform sampler2D mean;
uniform sampler2D basis;
uniform sampler2D rows; // four directions in a texel, a row for each head
uniform int head;
uniform float scale_m;

layout(location = 0) out vec4 xyz_m;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    ivec3 place = ivec3(texelFetch(places, texel, 0).xyz);
    vec3 moved = vec3(0.0);
    for (int row = place.y; row < place.z; ++row) {
        vec4 four = texelFetch(rows, ivec2(row >> 2, head), 0);
        moved += four[row & 3] * texelFetch(basis, ivec2(place.x, row), 0).xyz;
    }
    xyz_m = vec4(texelFetch(mean, texel, 0).xyz + scale_m * moved, 1.0);
}
