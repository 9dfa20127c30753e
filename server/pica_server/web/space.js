/**
 * Places, turns and cameras. World: metres, +y up. Matrices are rows one after another, for column
 * vectors; a camera's depth is metres before it.
 */

export const NEAR_M = 0.02;
const FAR_M = 20;

/** @type {(a: Vector, b: Vector) => number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vector, b: Vector) => Vector} */
export const cross = (a, b) =>
  [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** a + share * b. @type {(a: Vector, share: number, b: Vector) => Vector} */
export const along = (a, share, b) =>
  [a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]];
/** @type {(a: Vector, b: Vector) => Vector} */
export const minus = (a, b) => along(a, -1, b);
/** @param {Vector} a */
export const length = (a) => Math.hypot(...a);
/** Of length 1. @param {Vector} a */
export const unit = (a) => along([0, 0, 0], 1 / length(a), a);
/** @param {number} value */
export const sigmoid = (value) => 1 / (1 + Math.exp(-value));
/** @type {(value: number, low: number, high: number) => number} */
export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** @type {(a: Matrix, b: Matrix) => Matrix} */
export const multiply = (a, b) => Float64Array.from({ length: 16 }, (_, at) => {
  const [row, column] = [at & 12, at & 3];
  return a[row] * b[column] + a[row + 1] * b[4 + column] + a[row + 2] * b[8 + column] + a[row + 3]
    * b[12 + column];
});

/** A frame with these axes as columns. @type {(x: Vector, y: Vector, z: Vector, at: Vector) =>
 * Matrix} */
export const frame = (x, y, z, at) =>
  Float64Array.from([0, 1, 2].flatMap((row) => [x[row], y[row], z[row], at[row]])
    .concat(0, 0, 0, 1));

/** A column of a frame: 0 to 2 its axes, 3 its place. @type {(matrix: Matrix, index: number) =>
 * Vector} */
export const column = (matrix, index) => [matrix[index], matrix[4 + index], matrix[8 + index]];

/** Where a head is: its seat, moved and turned (axis times angle, radians) by its pose.
 * @param {Matrix} seat @param {ArrayLike<number>} pose Rotation, translation. */
export function headMatrix(seat, pose) {
  const angle = Math.hypot(pose[0], pose[1], pose[2]);
  const [x, y, z] = [0, 1, 2].map((k) => (angle < 1e-12 ? 0 : pose[k] / angle));
  const [sine, rest] = [Math.sin(angle), 1 - Math.cos(angle)];
  return multiply(seat, frame(
    [1 - rest * (y * y + z * z), sine * z + rest * x * y, rest * x * z - sine * y],
    [rest * x * y - sine * z, 1 - rest * (x * x + z * z), sine * x + rest * y * z],
    [sine * y + rest * x * z, rest * y * z - sine * x, 1 - rest * (x * x + y * y)],
    [pose[3], pose[4], pose[5]],
  ));
}

/** A camera that looks at a point, the world's y up in its picture. @type {(centre: Vector, target:
 * Vector, verticalFov: number, width: number, height: number) => Camera} */
export function lookAt(centre, target, verticalFov, width, height) {
  const forward = unit(minus(target, centre));
  const right = unit(cross(forward, [0, 1, 0]));
  const up = Math.tan(verticalFov / 2);
  const across = (up * width) / height;
  return { centre, axes: [right, cross(right, forward), forward], lens: [-across, -up, across, up],
    width, height };
}

/** From world to GL clip space, whose w is metres of depth. @param {Camera} camera @returns
 * {Matrix} */
export function clipFromWorld({ centre, axes, lens: [left, bottom, right, top] }) {
  const [x, y, z] = axes.map((axis) => [...axis, -dot(axis, centre)]);
  const depth = FAR_M - NEAR_M;
  return Float64Array.from([
    ...x.map((value, k) => (2 * value - (right + left) * z[k]) / (right - left)),
    ...y.map((value, k) => (2 * value - (top + bottom) * z[k]) / (top - bottom)),
    ...z.map((value, k) => ((FAR_M + NEAR_M) * value - (k === 3 ? 2 * FAR_M * NEAR_M : 0)) / depth),
    ...z,
  ]);
}

/** The camera as seen from a head, of length 1; from within it, straight ahead. @type {(head:
 * Matrix, centre: Vector) => Vector} */
export function viewDirection(head, centre) {
  const towards = minus(centre, column(head, 3));
  const away = length(towards);
  if (away < 1e-9) return [0, 0, 1];
  const turned =
    /** @type {Vector} */ ([0, 1, 2].map((index) => dot(column(head, index), towards)));
  return along([0, 0, 0], 1 / away, turned);
}

/** Where a point is on the picture, pixels from its upper left, and its depth. @type {(camera:
 * Camera, point: Vector) => Vector} */
export function project({ centre, axes, lens: [left, bottom, right, top], width, height }, point) {
  const [x, y, z] = axes.map((axis) => dot(axis, minus(point, centre)));
  return [((x / z - left) / (right - left)) * width, ((top - y / z) / (top - bottom)) * height, z];
}
