// The surface pass writes the number of the head with a fraction beside it (footprint.glsl).
bool is_owner(float owner, float slot) {
    return floor(owner) == slot;
}
