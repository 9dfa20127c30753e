// What edges are found by. Shaded images carry it in alpha, so that neighbours need not be summed up
// again.
float brightness(vec3 rgb) {
    return dot(rgb, vec3(0.299, 0.587, 0.114));
}
