/**
 * Places, turns and cameras. World: metres, +y up. Matrices are rows one after another, for column
 * vectors; a camera's depth is metres before it.
 */

/** @typedef {[number, number, number]} Vector */
/** @typedef {Float64Array} Matrix 16 numbers, row by row. */
/**
 * @typedef {object} Camera
 * @property {Vector} centre
 * @property {[Vector, Vector, Vector]} axes Right, up and forward in the world.
 * @property {[number, number, number, number]} lens Slopes of the picture's edges: left, bottom, right, top.
 * @property {number} width
 * @property {number} height
 */

export const NEAR_M = 0.02;
const FAR_M = 20;

/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
/** a + share * b. @param {Vector} a @param {number} share @param {Vector} b @returns {Vector} */
export const along = (a, share, b) => [a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const minus = (a, b) => along(a, -1, b);
/** @param {Vector} a */
export const length = (a) => Math.hypot(...a);
/** Of length 1. @param {Vector} a @returns {Vector} */
export const unit = (a) => along([0, 0, 0], 1 / length(a), a);
/** @param {number} value @param {number} low @param {number} high */
export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** @param {Matrix} a @param {Matrix} b @returns {Matrix} */
export function multiply(a, b) {
  const found = new Float64Array(16);
  for (let row = 0; row < 4; ++row) {
    for (let column = 0; column < 4; ++column) {
      let sum = 0;
      for (let k = 0; k < 4; ++k) {
        sum += a[4 * row + k] * b[4 * k + column];
      }
      found[4 * row + column] = sum;
    }
  }
  return found;
}

/** A frame with these axes as columns. @param {Vector} x @param {Vector} y @param {Vector} z @param {Vector} at @returns {Matrix} */
export function frame(x, y, z, at) {
  return Float64Array.from([0, 1, 2].flatMap((row) => [x[row], y[row], z[row], at[row]]).concat(0, 0, 0, 1));
}

/** A column of a frame: 0 to 2 its axes, 3 its place. @param {Matrix} matrix @param {number} index @returns {Vector} */
export const column = (matrix, index) => [matrix[index], matrix[4 + index], matrix[8 + index]];

/** Where a head is: its seat, moved and turned (axis times angle, radians) by its pose. @param {Matrix} seat @param {ArrayLike<number>} rotation @param {ArrayLike<number>} moved @returns {Matrix} */
export function headMatrix(seat, rotation, moved) {
  const angle = Math.hypot(rotation[0], rotation[1], rotation[2]);
  const [x, y, z] = angle < 1e-12 ? [0, 0, 0] : [0, 1, 2].map((k) => rotation[k] / angle);
  const [sine, rest] = [Math.sin(angle), 1 - Math.cos(angle)];
  return multiply(seat, frame(
    [1 - rest * (y * y + z * z), sine * z + rest * x * y, rest * x * z - sine * y],
    [rest * x * y - sine * z, 1 - rest * (x * x + z * z), sine * x + rest * y * z],
    [sine * y + rest * x * z, rest * y * z - sine * x, 1 - rest * (x * x + y * y)],
    [moved[0], moved[1], moved[2]],
  ));
}

/** A camera that looks at a point, the world's y up in its picture. @param {Vector} centre @param {Vector} target @param {number} verticalFov @param {number} width @param {number} height @returns {Camera} */
export function lookAt(centre, target, verticalFov, width, height) {
  const forward = unit(minus(target, centre));
  const right = unit(cross(forward, [0, 1, 0]));
  const up = Math.tan(verticalFov / 2);
  const across = (up * width) / height;
  return { centre, axes: [right, cross(right, forward), forward], lens: [-across, -up, across, up], width, height };
}

/** From world to GL clip space, whose w is metres of depth. @param {Camera} camera @returns {Matrix} */
export function clipFromWorld({ centre, axes, lens: [left, bottom, right, top] }) {
  const [x, y, z] = axes;
  const depth = FAR_M - NEAR_M;
  /** @param {Vector} axis */
  const row = (axis) => [...axis, -dot(axis, centre)];
  const [rowX, rowY, rowZ] = [row(x), row(y), row(z)];
  return Float64Array.from([
    ...rowX.map((value, k) => (2 * value - (right + left) * rowZ[k]) / (right - left)),
    ...rowY.map((value, k) => (2 * value - (top + bottom) * rowZ[k]) / (top - bottom)),
    ...rowZ.map((value, k) => ((FAR_M + NEAR_M) * value - (k === 3 ? 2 * FAR_M * NEAR_M : 0)) / depth),
    ...rowZ,
  ]);
}

/** The camera as seen from a head, of length 1; from within it, straight ahead. @param {Matrix} head @param {Vector} centre @returns {Vector} */
export function viewDirection(head, centre) {
  const towards = minus(centre, column(head, 3));
  const away = length(towards);
  if (away < 1e-9) {
    return [0, 0, 1];
  }
  return /** @type {Vector} */ ([0, 1, 2].map((index) => dot(column(head, index), towards) / away));
}

/** Where a point is on the picture, pixels from its upper left, and its depth. @param {Camera} camera @param {Vector} point @returns {Vector} */
export function project({ centre, axes, lens: [left, bottom, right, top], width, height }, point) {
  const [x, y, z] = axes.map((axis) => dot(axis, minus(point, centre)));
  return [((x / z - left) / (right - left)) * width, ((top - y / z) / (top - bottom)) * height, z];
}
