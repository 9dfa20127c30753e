// A head without an avatar: a plain bust in the room's light. The shape is an ellipsoid about the
// origin, so the position itself says where the surface looks.

uniform sampler2D visible_xyz;
uniform float slot;
uniform float mark;
uniform vec4 tint;
uniform vec3 radii_m;

layout(location = 0) out vec4 colour;

#include "owner.glsl"
#include "mark.glsl"

void main() {
    vec4 surface = texelFetch(visible_xyz, ivec2(gl_FragCoord.xy), 0);
    if (!is_owner(surface.w, slot)) {
        discard;
    }
    vec3 normal = normalize(surface.xyz / (radii_m * radii_m));
    float light = 0.5 + 0.5 * dot(normal, normalize(vec3(0.25, 0.8, 0.55)));
    vec3 rgb = mix(vec3(0.19, 0.215, 0.25), vec3(0.47, 0.50, 0.54), light * light);
    colour = vec4(mix(rgb, tint.rgb, tint.a), mark_of(mark));
}
