// Where a bust fades it yields to whoever is behind it: the lower, the further away it counts, without
// a step. Done at vertices, for a program that discards pixels has its depth tested late.

uniform vec2 shown; // height at which nothing is left, height from which all is there

// Times the height: with more, neighbours in a row change places, one being a little behind.
const float RECEDING = 2.0;

vec4 yielding(vec4 place, float height_m) {
    float further_m = RECEDING * max(shown.y - height_m, 0.0);
    float nearer = place.w / (max(place.w, 1e-3) + further_m); // behind the camera nothing is divided by 0
    return vec4(place.xy, place.w - (place.w - place.z) * nearer, place.w);
}
