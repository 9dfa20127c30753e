// The vertices of a head: the mean, and what the directions of each one's region add.

uniform usampler2DArray places; // column in the basis, first row and the one after the last
uniform sampler2DArray mean;
uniform sampler2DArray basis; // signed bytes, from 0 to 1
uniform int head; // which of the batch
uniform sampler2D rows; // four directions in a texel, a row for each head

layout(location = 0) out vec4 xyz_m;

#include "decode.glsl"

void main() {
    int avatar = avatar_of(head);
    ivec3 texel = ivec3(gl_FragCoord.xy, avatar);
    ivec3 sum = ivec3(texelFetch(places, texel, 0).xyz);
    vec3 moved = vec3(0.0);
    float all = 0.0;
    for (int row = sum.y & ~3; row < sum.z; row += 4) {
        // Four directions at a time; what belongs to neighbouring regions counts nothing.
        ivec4 four = row + ivec4(0, 1, 2, 3);
        vec4 weight = texelFetch(rows, ivec2(row >> 2, head), 0);
        weight *= vec4(greaterThanEqual(four, ivec4(sum.y))) * vec4(lessThan(four, ivec4(sum.z)));
        moved += weight.x * texelFetch(basis, ivec3(sum.x, row, avatar), 0).xyz;
        moved += weight.y * texelFetch(basis, ivec3(sum.x, row + 1, avatar), 0).xyz;
        moved += weight.z * texelFetch(basis, ivec3(sum.x, row + 2, avatar), 0).xyz;
        moved += weight.w * texelFetch(basis, ivec3(sum.x, row + 3, avatar), 0).xyz;
        all += dot(weight, vec4(1.0));
    }
    float scale_m = texelFetch(heads, ivec2(SCALE, head), 0).x;
    vec3 mean_m = texelFetch(mean, texel, 0).xyz;
    xyz_m = vec4(mean_m + scale_m * (255.0 * moved - 128.0 * all) / 127.0, 1.0);
}
