// A head without an avatar: a plain bust in the room's light, matt as clay.

uniform sampler2D visible_xyz;
uniform sampler2D visible_uv;
uniform sampler2D position_map;

layout(location = 0) out vec4 colour;

#include "pixels.glsl"

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 surface = texelFetch(visible_xyz, pixel, 0);
    // Where the surface looks follows from its neighbours in the map.
    vec2 uv = texelFetch(visible_uv, pixel, 0).xy;
    vec2 texel = 1.0 / vec2(textureSize(position_map, 0));
    vec2 right = vec2(texel.x, 0.0), down = vec2(0.0, texel.y);
    vec3 along = textureLod(position_map, uv + right, 0.0).xyz - textureLod(position_map, uv - right, 0.0).xyz;
    vec3 below = textureLod(position_map, uv + down, 0.0).xyz - textureLod(position_map, uv - down, 0.0).xyz;
    vec3 normal = normalize(cross(below, along) + vec3(0.0, 1e-9, 0.0));
    float light = 0.5 + 0.5 * dot(normal, normalize(vec3(0.30, 0.75, 0.60)));
    vec3 rgb = mix(vec3(0.205, 0.225, 0.250), vec3(0.520, 0.545, 0.570), light * light);
    colour = presence(surface.xyz) * vec4(rgb, 1.0);
}
