/**
 * What every head gets in a frame: level, what to decode, share of its stream; the rules of
 * `schedule/` in the Python client, whose docstrings say why. Pure. What decoding and drawing cost
 * here is learned as a multiple of what they cost elsewhere, one for each.
 */

import { LEVELS, MAP_SIZE } from "./avatar.js";
import { clamp, clipFromWorld, dot, multiply, NEAR_M, viewDirection } from "./space.js";

const DETAIL_PX = [80, 900];
const SHARE_PX = [12, 32];
const [LEAST_CHANGE, LEAST_TURN_RAD, FACE_S, MAX_AGE_S] = [0.05, 1e-3, 1 / 30, 0.25];
export const LISTENER_S = 1 / 8;
const [STREAM_HOLD_S, STEP, MOST_TURNS, RAISE_RATIO, KEEP_RATIO] = [1, 1.1, 48, 0.95, 0.85];
const [SMOOTHING, SCALES] = [0.05, [0.5, 0.75, 1]];
/** @type {Record<Decode, Record<number, number>>} */
const EXPECTED_DECODE_S = {
  none: {},
  expression: { 64: 0.3e-3, 128: 0.9e-3, [MAP_SIZE]: 1.5e-3 },
  both: { 64: 0.5e-3, 128: 1.7e-3, [MAP_SIZE]: 2.9e-3 },
};
const EXPECTED_DRAW_S = [1.5e-3, 60e-9, 60e-9];
const [WINDOW, MAX_SECONDS] = [9, 10];
const [NUM_POINTS, HIDER_SIZE, HIDDEN_SHARE, LEAST_PX] = [64, 0.9, 0.98, 0.25];
/** Points that cover the unit disc evenly: Vogel's sunflower. */
const DISC = Array.from({ length: NUM_POINTS }, (_, index) => {
  const [radius, turn] =
    [Math.sqrt((index + 0.5) / NUM_POINTS), index * Math.PI * (3 - Math.sqrt(5))];
  return [radius * Math.cos(turn), radius * Math.sin(turn)];
});
const LONG_AGO_S = -1e9;
/** @type {Sight} */
const NOTHING = { visiblePx: 0, headPx: 0 };

/** A head with a face, kept from frame to frame by the code that draws it. */
export class Head {
  /** Head frame to world. @type {Matrix} */
  matrix = new Float64Array(16);
  /** @type {Float32Array} */
  latent = new Float32Array(256);
  /** Whether others speak. */
  isListening = false;
  sight = NOTHING;
  /** @type {Vector} */
  viewDirection = [0, 0, 1];
  latentChange = 0;
  viewTurnRad = 0;
  /** When it was last to be seen. @type {number | null} */
  seenS = null;
  /** @type {Choice | null} */
  choice = null;
  /** The decode that was asked for last, and when one of both maps was.
   * @type {{latent: Float32Array, view: Vector, level: number} | null} */
  asked = null;
  askedS = LONG_AGO_S;
  latentAskedS = LONG_AGO_S;

  /** @param {Pick<Manifest, "bounds_min_m" | "bounds_max_m">} box
   * @param {number[]} numTriangles Of each level. */
  constructor(box, numTriangles) {
    this.box = box;
    this.numTriangles = numTriangles;
  }

  /** What its choice decodes, null for nothing; it counts as asked for. @param {number} now */
  request(now) {
    const { choice, asked, viewDirection: view } = this;
    if (!choice || choice.decode === "none") return null;
    // Without new positions, both maps must be of the same face.
    const isBoth = choice.decode === "both" || !asked;
    const latent = isBoth ? this.latent.slice() : asked.latent;
    if (isBoth) this.latentAskedS = now;
    this.asked = { latent, view, level: choice.level };
    this.askedS = now;
    return { ...this.asked, isBoth };
  }
}

/** Tell each head what a camera sees of it and how far it has moved. @param {Head[]} heads
 * @param {Camera} camera */
export function seeHeads(heads, camera) {
  const sights = look(heads, camera);
  heads.forEach((head, index) => {
    head.sight = sights[index];
    head.viewDirection = viewDirection(head.matrix, camera.centre);
    const { asked, latent } = head;
    const change = asked
      ? latent.reduce((sum, value, at) => sum + (value - asked.latent[at]) ** 2, 0) : 0;
    head.latentChange = Math.sqrt(change / latent.length);
    const cosine = asked ? dot(head.viewDirection, asked.view) : 1;
    head.viewTurnRad = Math.acos(clamp(cosine, -1, 1));
  });
}

/** What can be seen of each head through a camera; see `schedule/visibility.py`.
 * @type {(heads: Head[], camera: Camera) => Sight[]} */
function look(heads, camera) {
  const { width, height } = camera;
  const projection = clipFromWorld(camera);
  const seen = heads.map(({ matrix, box }) => ellipseOf(multiply(projection, matrix), box));
  const outlined = seen.filter(({ isOutlined }) => isOutlined);
  return seen.map((own) => {
    if (!own.isOutlined) {
      return own.isBefore ? { visiblePx: width * height, headPx: height } : NOTHING;
    }
    const places = DISC.map(([u, v]) => [own.x + own.a * u, own.y + own.b * u + own.c * v]);
    const onScreen = places.filter((place) => place.every((side) => Math.abs(side) <= 1));
    const numSeen = onScreen.filter(([x, y]) => !outlined.some((hider) => {
      const across = (x - hider.x) / hider.a;
      const up = (y - hider.y - hider.b * across) / hider.c;
      return own.depth > hider.depth && across * across + up * up <= HIDER_SIZE ** 2;
    })).length;
    const visiblePx = ((Math.PI / 4) * width * height * own.a * own.c * numSeen) / NUM_POINTS;
    const isSeen = numSeen > (1 - HIDDEN_SHARE) * onScreen.length && visiblePx >= LEAST_PX;
    return isSeen ? { visiblePx, headPx: Math.hypot(own.b, own.c) * height } : NOTHING;
  });
}

/** The ellipse that the ellipsoid within a box is on the screen: its middle, and the image of the
 * unit disc, lower triangular. @param {Matrix} matrix To clip space. @param {Head["box"]} box */
function ellipseOf(matrix, { bounds_min_m: low, bounds_max_m: high }) {
  // The ellipsoid is the image of the unit ball; rows x, y and w see its centre and its axes.
  const isSound = matrix.every(Number.isFinite);
  const rows =
    [0, 1, 3].map((row) => (isSound ? matrix.slice(4 * row, 4 * row + 4) : [0, 0, 0, 0]));
  const centre = rows.map((row) =>
    row[3] + [0, 1, 2].reduce((sum, axis) => sum + (row[axis] * (low[axis] + high[axis])) / 2, 0));
  const axes =
    rows.map((row) => [0, 1, 2].map((axis) => (row[axis] * (high[axis] - low[axis])) / 2));
  const [depth, reach] = [centre[2], Math.hypot(...axes[2])];
  /** @type {(i: number, j: number) => number} */
  const conic = (i, j) =>
    centre[i] * centre[j] - axes[i].reduce((sum, value, axis) => sum + value * axes[j][axis], 0);
  const scale = conic(2, 2);
  const [x, y] = [conic(0, 2) / scale, conic(1, 2) / scale];
  const a = Math.sqrt(Math.max(x * x - conic(0, 0) / scale, 1e-30));
  const b = (x * y - conic(0, 1) / scale) / a;
  const c = Math.sqrt(Math.max(y * y - conic(1, 1) / scale - b * b, 1e-30));
  return { depth, isBefore: depth + reach > NEAR_M, isOutlined: depth - reach > NEAR_M, x,
    y, a, b, c };
}

/** What decoding and drawing cost on this machine. @implements {Costs} */
export class CostModel {
  draw = EXPECTED_DRAW_S;
  decodeSlowness = 1;
  /** @type {number[]} */
  _drawRatios = [];

  /** @param {number} seconds That decoding both maps at a level takes. @param {number} level */
  observeDecode(seconds, level) {
    this.decodeSlowness = seconds / EXPECTED_DECODE_S.both[level];
  }

  /** @type {Costs["decodeS"]} */
  decodeS(level, decode) {
    return this.decodeSlowness * EXPECTED_DECODE_S[decode][level];
  }

  /** @param {number} triangles @param {number} pixels @param {number} seconds */
  observeDraw(triangles, pixels, seconds) {
    if (!(seconds > 0 && seconds <= MAX_SECONDS)) return;
    const [frameS, triangleS, pixelS] = EXPECTED_DRAW_S;
    this._drawRatios.push(seconds / (frameS + triangleS * triangles + pixelS * pixels));
    this._drawRatios = this._drawRatios.slice(-WINDOW);
    const slowness = this._drawRatios.slice().sort((a, b) => a - b)[this._drawRatios.length >> 1];
    this.draw = EXPECTED_DRAW_S.map((each) => slowness * each);
  }
}

/** Plans frame after frame. */
export class Scheduler {
  isShort = false;
  _turns = 0;
  _sinceS = FACE_S;
  _now = -Infinity;

  /** @param {Costs} costs */
  constructor(costs) {
    this.costs = costs;
  }

  /** Choose what everybody gets in the frame that begins now; each head is told.
   * @param {Head[]} heads @param {number} budgetS @param {number} now */
  plan(heads, budgetS, now) {
    this._sinceS += SMOOTHING * (Math.min(now - this._now, LISTENER_S) - this._sinceS);
    this._now = now;
    const seen = heads.filter(({ sight }) => sight !== NOTHING);
    // What a head has counts as height: two who sway side by side must not change places.
    const heights = new Map(seen.map((head) =>
      [head, head.sight.headPx * STEP ** Math.max(LEVELS.indexOf(head.choice?.level ?? 0), 0)]));
    seen.sort((a, b) => (heights.get(a) ?? 0) - (heights.get(b) ?? 0));
    const shrinks = this._fit(seen, budgetS);
    let spentS = this._drawS(seen, shrinks);
    let [hasDecoded, shadedPx] = [false, 0];
    const areFew = 2 * seen.filter(({ isListening }) => !isListening).length <= seen.length;
    const turns = seen.map((head, index) => ({ head, shrink: shrinks[index] }));
    turns.sort((a, b) => a.head.askedS - b.head.askedS
      || b.head.sight.headPx - a.head.sight.headPx);
    for (const { head, shrink } of turns) {
      head.seenS = now;
      const scale = scaleOf(head, shrink);
      let level = placeOf(head, shrink);
      let decode = wanted(head, LEVELS[level], now);
      if (decode !== "none") {
        // One is decoded in any case, so that not all are overdue at once, and the few who speak.
        const askedS = decode === "both" ? head.latentAskedS : head.askedS;
        const isNeeded = now - askedS >= MAX_AGE_S || !hasDecoded || (areFew && !head.isListening);
        const held = head.asked ? LEVELS.indexOf(head.asked.level) : level;
        const decodeS = this.costs.decodeS(LEVELS[level], decode);
        if (isNeeded || held > level || spentS + decodeS <= budgetS) {
          spentS += decodeS;
          hasDecoded = true;
        } else {
          [decode, level] = ["none", held];
        }
      }
      shadedPx += scale ** 2 * head.sight.visiblePx;
      head.choice = { level: LEVELS[level], decode, scale, every: this._every(head) };
    }
    for (const head of heads.filter(({ sight }) => sight === NOTHING)) {
      head.seenS ??= now;
      const level = head.asked?.level ?? LEVELS[0];
      head.choice =
        { level, decode: "none", scale: 1, every: now - head.seenS < STREAM_HOLD_S ? 1 : 0 };
    }
    return { costS: spentS, shadedPx };
  }

  /** How many times smaller each head must count, the lowest first.
   * @type {(seen: Head[], budgetS: number) => number[]} */
  _fit(seen, budgetS) {
    /** @param {number} turns */
    const costS = (turns) => {
      const shrinks = shrinksOf(seen.length, turns);
      return this._drawS(seen, shrinks) + seen.reduce((sum, head, index) =>
        sum + this._share(head)
          * this.costs.decodeS(LEVELS[placeOf(head, shrinks[index])], "both"), 0);
    };
    const wasShort = this.isShort;
    this.isShort = false;
    this.isShort = costS(0) > budgetS * (wasShort ? RAISE_RATIO : 1);
    const most = seen.length * MOST_TURNS;
    this._turns = Math.min(this._turns, most);
    while (this._turns > 0 && costS(this._turns - 1) < RAISE_RATIO * budgetS) --this._turns;
    while (this._turns < most && costS(this._turns) > budgetS) ++this._turns;
    return shrinksOf(seen.length, this._turns);
  }

  /** The share of images in which a head is drawn. @param {Head} head */
  _share({ isListening }) {
    return Math.min(this._sinceS / (this.isShort && isListening ? LISTENER_S : FACE_S), 1);
  }

  /** Which frames of its stream are wanted. @param {Head} head */
  _every({ isListening, sight: { headPx } }) {
    const every = headPx < SHARE_PX[0] ? 4 : headPx < SHARE_PX[1] ? 2 : 1;
    return every === 1 && this.isShort && isListening ? 2 : every;
  }

  /** Seconds an image, on average, that drawing takes.
   * @type {(seen: Head[], shrinks: number[]) => number} */
  _drawS(seen, shrinks) {
    const [frameS, triangleS, pixelS] = this.costs.draw;
    return seen.reduce((sum, head, index) => {
      const triangles = head.numTriangles[placeOf(head, shrinks[index])];
      const pixels = scaleOf(head, shrinks[index]) ** 2 * head.sight.visiblePx;
      return sum + this._share(head) * (pixelS * pixels + triangleS * triangles);
    }, seen.length ? frameS : 0);
  }
}

/** Which of the levels a head gets. @type {(head: Head, shrink: number) => number} */
function placeOf({ asked, sight }, shrink) {
  const held = asked ? LEVELS.indexOf(asked.level) : 0;
  const height = sight.headPx / shrink;
  return DETAIL_PX.filter((least, number) =>
    height >= least * (number < held ? KEEP_RATIO : 1)).length;
}

/** The share of the resolution that a head is drawn with.
 * @type {(head: Head, shrink: number) => number} */
function scaleOf({ choice, sight }, shrink) {
  const height = Math.max(sight.headPx, 1e-3);
  const excess = Math.max((shrink * Math.min(height, DETAIL_PX[0])) / height, 1);
  return SCALES.find((scale) => scale * excess >= (scale >= (choice?.scale ?? 1) ? KEEP_RATIO : 1))
    ?? 1;
}

/** What to decode at a level. @type {(head: Head, level: number, now: number) => Decode} */
function wanted(head, level, now) {
  // Turning asks for expression maps again and again: they do not make the latent newer.
  const isOld = now - head.latentAskedS >= MAX_AGE_S / 2;
  if (head.asked?.level !== level || head.latentChange > (isOld ? 0 : LEAST_CHANGE)) return "both";
  return head.viewTurnRad > LEAST_TURN_RAD ? "expression" : "none";
}

/** How many times smaller heads count after so many turns, the lowest first.
 * @type {(count: number, turns: number) => number[]} */
const shrinksOf = (count, turns) => Array.from({ length: count },
    (_, rank) => STEP ** Math.floor((turns + count - 1 - rank) / count));
