/**
 * A worker that sees a face in a camera's pictures, as `sources/webcam.py` and `face_networks.py`
 * do. It may connect to nothing.
 */

import { Tracking } from "./live_face.js";
import { openNetwork } from "./networks.js";
import { along, clamp, cross, dot, minus, sigmoid } from "./space.js";

/** @typedef {{data: ArrayLike<number>, width: number, height: number}} Pixels Red, green, blue and
 * one more. */
/** @typedef {{x: number, y: number, side: number, angle: number}} Region A turned square. */
/** @typedef {{shape_landmarks: number[], shapes: number[], head: Record<string, Vector>}} Numbers
 * Of `pica_core/face_networks.json`. */

/** Where the detector, the landmarks' network and that of the shapes lie in their file, bytes. */
const MEMBERS = [[52, 229_746], [229_860, 2_553_590], [2_802_960, 955_312]];
const [DETECTOR_PX, CROP_PX, MARGIN, SCORE, SAME_FACE, PRESENT] = [128, 256, 1.5, 0.5, 0.3, 0.5];
const [MAX_SIDE, OUTER_CORNERS] = [4, [33, 263]];
const [DEPTH_FACTOR, UNIT_M, FOCAL_LENGTH] = [0.8, 0.06, 0.9];

/** What a region shows, bilinear and black outside of the picture, each value within [low, 1].
 * @type {(pixels: Pixels, region: Region, size: number, low?: number) => Float32Array} */
function crop({ data, width, height }, { x, y, side, angle }, size, low = 0) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const found = new Float32Array(3 * size * size).fill(low);
  for (let at = 0; at < size * size; at++) {
    const [u, v] = [at % size, Math.floor(at / size)].map((k) => ((k + 0.5) / size - 0.5) * side);
    const [column, row] = [x + u * cos - v * sin, y + u * sin + v * cos];
    if (!(column >= 0 && column < width && row >= 0 && row < height)) continue;
    const [left, top] = [Math.floor(column - 0.5), Math.floor(row - 0.5)];
    const [across, down] = [column - 0.5 - left, row - 0.5 - top];
    const [l, r] = [Math.max(left, 0), Math.min(left + 1, width - 1)];
    const [t, b] = [Math.max(top, 0) * width, Math.min(top + 1, height - 1) * width];
    for (let c = 0; c < 3; c++) {
      const above = data[4 * (t + l) + c] * (1 - across) + data[4 * (t + r) + c] * across;
      const below = data[4 * (b + l) + c] * (1 - across) + data[4 * (b + r) + c] * across;
      found[3 * at + c] = low + (1 - low) * Math.floor(above + (below - above) * down) / 255;
    }
  }
  return found;
}

/** A point of a region, whose sides are 1, in the picture.
 * @type {(region: Region, point: Vector) => Vector} */
function toPicture({ x, y, side, angle }, point) {
  const [u, v] = [point[0] - 0.5, point[1] - 0.5];
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return [x + (u * cos - v * sin) * side, y + (u * sin + v * cos) * side, point[2] * side];
}

/** One box a face: those that overlap, weighed by their scores.
 * @param {{score: number, values: number[]}[]} boxes */
function merged(boxes) {
  let left = boxes.slice().sort((a, b) => b.score - a.score);
  const found = [];
  while (left.length) {
    const a = left[0].values;
    /** @param {number[]} b */
    const isSame = (b) => {
      const [wide, high] = [0, 1].map((k) => Math.max(Math.min(a[k] + a[k + 2] / 2, b[k]
        + b[k + 2] / 2) - Math.max(a[k] - a[k + 2] / 2, b[k] - b[k + 2] / 2), 0));
      return wide * high / (a[2] * a[3] + b[2] * b[3] - wide * high + 1e-9) > SAME_FACE;
    };
    const alike = left.filter((box, index) => !index || isSame(box.values));
    const sum = alike.reduce((total, { score }) => total + score, 0);
    found.push(left[0].values.map((_, k) =>
      alike.reduce((total, { score, values }) => total + score * values[k], 0) / sum));
    left = left.filter((box) => !alike.includes(box));
  }
  return found;
}

/** Where to look for a face. @type {(x: number, y: number, size: number, right: number[], left:
 * number[]) => Region} */
const regionAt = (x, y, size, right, left) => ({ x, y, side: MARGIN * size,
  angle: Math.atan2(left[1] - right[1], left[0] - right[0]) });

/** The head's turn (axis times angle) and its place before the camera, metres. @type {(landmarks:
 * Vector[], head: Numbers["head"], width: number, height: number) => number[]} */
export function headPose(landmarks, head, width, height) {
  /** @param {Vector[]} points */
  const centred = (points) => {
    const middle = points.reduce((sum, point) => along(sum, 1 / points.length, point), [0, 0, 0]);
    return { middle, points: points.map((point) => minus(point, middle)) };
  };
  const model = centred(Object.values(head)).points;
  const { middle, points } = centred(Object.keys(head).map((index) => {
    const [x, y, z] = landmarks[Number(index)];
    return [x, -y, -DEPTH_FACTOR * z];
  }));
  /** @param {Vector[]} all */
  const power = (all) => all.reduce((sum, point) => sum + dot(point, point), 0);
  // The rotation nearest to what the model's axes have become.
  let rows = /** @type {Vector[]} */ ([0, 1, 2].map((row) => [0, 1, 2].map((k) =>
    points.reduce((sum, point, index) => sum + point[row] * model[index][k], 0))));
  rows = rows.map((row) => along([0, 0, 0], 1 / Math.sqrt(power(rows)), row));
  for (let turn = 0; turn < 30; turn++) {
    const [a, b, c] = rows;
    const volume = dot(a, cross(b, c));
    rows = [cross(b, c), cross(c, a), cross(a, b)].map((across, k) =>
      along([0, 0, 0], 0.5, along(rows[k], 1 / volume, across)));
  }
  const [a, b, c] = rows;
  /** @type {Vector} */
  const axis = [c[1] - b[2], a[2] - c[0], b[0] - a[1]];
  const sine = Math.hypot(...axis) / 2;
  const angle = Math.atan2(sine, (a[0] + b[1] + c[2] - 1) / 2);
  const scale = UNIT_M * Math.sqrt(power(model) / power(points));
  return [...along([0, 0, 0], sine > 1e-9 ? angle / (2 * sine) : 0.5, axis),
    (middle[0] - width / 2) * scale, (middle[1] + height / 2) * scale,
    -FOCAL_LENGTH * width * scale];
}

/** Follows one face: the largest, until it is lost. */
export class FaceFinder {
  /** @type {Vector[] | null} */
  landmarks = null;
  /** Middles of the detector's cells. */
  anchors = [[16, 2], [8, 6]].flatMap(([cells, count]) => Array.from(
    { length: cells * cells * count },
    (_, at) => [Math.floor(at / count) % cells, Math.floor(at / count / cells)]
      .map((place) => (place + 0.5) / cells)));

  /** @param {Uint8Array} task `face_landmarker.task`. @param {Numbers} numbers */
  constructor(task, numbers) {
    this.numbers = numbers;
    this.networks = MEMBERS.map(([at, size]) =>
      openNetwork(new DataView(task.buffer, task.byteOffset + at, size)));
  }

  /** Where faces are, the largest first. @param {Pixels} pixels */
  detect(pixels) {
    const { width, height } = pixels;
    const whole = { x: width / 2, y: height / 2, side: Math.max(width, height), angle: 0 };
    const [offsets, logits] = this.networks[0](crop(pixels, whole, DETECTOR_PX, -1));
    const boxes = Array.from(logits, (logit, index) => ({ score: sigmoid(logit), index }))
      .filter(({ score }) => score > SCORE).map(({ score, index }) => ({
        score,
        // Middle, size and six points, two of them the eyes; all but the size from the anchor.
        values: Array.from(offsets.subarray(16 * index, 16 * index + 16), (value, k) =>
          value / DETECTOR_PX + (k === 2 || k === 3 ? 0 : this.anchors[index][k % 2])),
      }));
    return merged(boxes).map((values) => {
      const [middle, , right, left] =
        [0, 2, 4, 6].map((k) => toPicture(whole, [values[k], values[k + 1], 0]));
      const size = whole.side * Math.max(values[2], values[3]);
      return regionAt(middle[0], middle[1], size, right, left);
    }).sort((a, b) => b.side - a.side);
  }

  /** Look for landmarks in a region. @param {Pixels} pixels @param {Region} region */
  follow(pixels, region) {
    this.landmarks = null;
    const { width, height } = pixels;
    if (!(region.side > 1 && region.side < MAX_SIDE * Math.max(width, height))) return false;
    const [points, [presence]] = this.networks[1](crop(pixels, region, CROP_PX));
    if (sigmoid(presence) < PRESENT) return false;
    this.landmarks = Array.from({ length: points.length / 3 }, (_, index) => toPicture(region,
      /** @type {any} */ (Array.from(points.subarray(3 * index, 3 * index + 3), (value) =>
        value / CROP_PX))));
    return true;
  }

  /** What the next picture shows: 52 shapes, the head's turn and place; null without a face.
   * @param {Pixels} pixels */
  find(pixels) {
    const former = this.landmarks;
    if (!(former && this.follow(pixels, regionOf(former)))
      && !this.detect(pixels).some((region) => this.follow(pixels, region))) return null;
    const landmarks = /** @type {Vector[]} */ (this.landmarks);
    const { shape_landmarks: given, shapes, head } = this.numbers;
    const [answers] = this.networks[2](given.flatMap((index) => landmarks[index].slice(0, 2)));
    const found = new Float32Array(58);
    shapes.forEach((shape, index) => {
      if (shape >= 0) found[shape] = clamp(answers[index], 0, 1);
    });
    found.set(headPose(landmarks, head, pixels.width, pixels.height), 52);
    return found;
  }
}

/** Where to look for a face whose landmarks were there a moment ago. @param {Vector[]} landmarks */
function regionOf(landmarks) {
  const sides = [0, 1].map((axis) => {
    const values = landmarks.map((point) => point[axis]);
    return { low: Math.min(...values), high: Math.max(...values) };
  });
  const [x, y] = sides.map(({ low, high }) => (low + high) / 2);
  const size = Math.max(...sides.map(({ low, high }) => high - low));
  const [right, left] = OUTER_CORNERS.map((index) => landmarks[index]);
  return regionAt(x, y, size, right, left);
}

const tracking = new Tracking();
/** @type {FaceFinder | null} */
let finder = null;
/** @type {OffscreenCanvas | null} */
let canvas = null;
/** First the networks, then picture after picture; the answer is the face, or none. It waits, too:
 * a page in the background has slow timers. @param {MessageEvent} event */
globalThis.onmessage = ({ data: { task, numbers, picture, atS, waitMs } }) => {
  if (task) finder = new FaceFinder(task, numbers);
  if (!picture) return setTimeout(() => postMessage(null), waitMs);
  /** @type {ImageBitmap} */
  const { width, height } = picture;
  if (canvas?.width !== width || canvas.height !== height) {
    canvas = new OffscreenCanvas(width, height);
  }
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context?.drawImage(picture, 0, 0);
  picture.close();
  const pixels = context?.getImageData(0, 0, width, height);
  const found = finder && pixels ? finder.find(pixels) : null;
  const face = found ? tracking.push(found, atS) : tracking.lose();
  return postMessage({ face, wish: tracking.wish });
};
