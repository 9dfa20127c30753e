// A position inside its box. What is no number fails every comparison, and falls to the origin:
// a broken map must not reach over the screen and hide its neighbours.
vec3 bounded(vec3 xyz_m, vec3 low_m, vec3 high_m) {
    bool is_sound = all(lessThan(abs(xyz_m), vec3(1e6)));
    return clamp(is_sound ? xyz_m : vec3(0.0), low_m, high_m);
}
