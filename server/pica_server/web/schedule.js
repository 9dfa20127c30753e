/**
 * What every head gets in a frame: level, what to decode, share of its stream; the rules of
 * `schedule/` in the Python client, whose docstrings say why. Pure.
 */

import { clamp, clipFromWorld, multiply, NEAR_M, viewDirection } from "./space.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Camera, Matrix, Vector } from "./space.js" */
/** @typedef {"none" | "expression" | "both"} Decode */
/** @typedef {{visiblePx: number, headPx: number, numViews: number}} Sight Pixels that nearer heads do not hide; the head's height. */
/** @typedef {{level: number, decode: Decode, scale: number, every: 0 | 1 | 2 | 4}} Choice */
/** @typedef {{latent: Float32Array, view: Vector, level: number}} Asked */

const DETAIL_PX = [80, 900];
const SHARE_PX = [12, 32];
const [LEAST_CHANGE, LEAST_TURN_RAD, FACE_S, MAX_AGE_S] = [0.05, 1e-3, 1 / 30, 0.25];
export const LISTENER_S = 1 / 8;
const [STREAM_HOLD_S, STEP, MOST_TURNS, RAISE_RATIO, KEEP_RATIO] = [1, 1.1, 48, 0.95, 0.85];
const SCALES = [0.5, 0.75, 1];
/** @type {Record<string, Record<number, number>>} */
const EXPECTED_DECODE_S = {
  both: { 64: 0.5e-3, 128: 1.7e-3, 256: 2.9e-3 },
  expression: { 64: 0.3e-3, 128: 0.9e-3, 256: 1.5e-3 },
};
const EXPECTED_DRAW_S = [1.5e-3, 60e-9, 60e-9];
const [WINDOW, GUARD, SPIKE, FADE, PRIOR_WEIGHT] = [9, 5, 3, 0.98, 0.003];
const [MIN_SECONDS, MAX_SECONDS] = [1e-7, 10];
const [NUM_POINTS, HIDER_SIZE, HIDDEN_SHARE, LEAST_PX] = [64, 0.9, 0.98, 0.25];
/** Points that cover the unit disc evenly: Vogel's sunflower. */
const DISC = Array.from({ length: NUM_POINTS }, (_, index) => {
  const [radius, turn] = [Math.sqrt((index + 0.5) / NUM_POINTS), index * Math.PI * (3 - Math.sqrt(5))];
  return [radius * Math.cos(turn), radius * Math.sin(turn)];
});
/** @type {Sight} */
const NOTHING = { visiblePx: 0, headPx: 0, numViews: 0 };

/** A head with a face, kept from frame to frame by the code that draws it. */
export class Head {
  /** @param {string} slot @param {Pick<Avatar, "levels" | "manifest"> & {faces: (level: number) => ArrayLike<number>}} avatar */
  constructor(slot, avatar) {
    this.slot = slot;
    this.levels = avatar.levels;
    this.box = avatar.manifest;
    this.numTriangles = avatar.levels.map((level) => avatar.faces(level).length / 3);
    /** Head frame to world. @type {Matrix} */
    this.matrix = new Float64Array(16);
    this.latent = /** @type {Float32Array} */ (new Float32Array(256));
    /** Whether others speak. */
    this.isListening = false;
    this.sight = NOTHING;
    /** @type {Vector} */
    this.viewDirection = [0, 0, 1];
    this.latentChange = 0;
    this.viewTurnRad = 0;
    /** When it was last to be seen. @type {number | null} */
    this.seenS = null;
    /** @type {Choice | null} */
    this.choice = null;
    /** The decode that was asked for last. @type {Asked | null} */
    this.asked = null;
    this.askedS = -Infinity;
    this.latentAskedS = -Infinity;
  }

  /** What its choice decodes, null for nothing; it counts as asked for. @param {number} now */
  request(now) {
    const { choice } = this;
    if (!choice || choice.decode === "none") {
      return null;
    }
    const isBoth = choice.decode === "both" || !this.asked;
    // Without new positions, both maps must be of the same face.
    const latent = isBoth ? this.latent.slice() : /** @type {Asked} */ (this.asked).latent;
    this.latentAskedS = isBoth ? now : this.latentAskedS;
    this.asked = { latent, view: this.viewDirection, level: choice.level };
    this.askedS = now;
    return { slot: this.slot, latent, view: this.viewDirection, level: choice.level, isBoth };
  }
}

/** Tell each head what cameras see of it and how far it has moved. @param {Head[]} heads @param {Camera[]} cameras One, or both eyes'. */
export function seeHeads(heads, cameras) {
  const eyes = cameras.map((camera) => look(heads, camera));
  const middle = /** @type {Vector} */ ([0, 1, 2].map((axis) => cameras.reduce((sum, camera) => sum + camera.centre[axis] / cameras.length, 0)));
  heads.forEach((head, index) => {
    head.sight = eyes.map((sights) => sights[index]).reduce((a, b) => ({
      visiblePx: a.visiblePx + b.visiblePx,
      headPx: Math.max(a.headPx, b.headPx),
      numViews: a.numViews + b.numViews,
    }));
    head.viewDirection = viewDirection(head.matrix, middle);
    const { asked, latent, viewDirection: [x, y, z] } = head;
    const change = asked ? latent.reduce((sum, value, at) => sum + (value - asked.latent[at]) ** 2, 0) : 0;
    head.latentChange = Math.sqrt(change / latent.length);
    head.viewTurnRad = asked ? Math.acos(clamp(x * asked.view[0] + y * asked.view[1] + z * asked.view[2], -1, 1)) : 0;
  });
}

/** What can be seen of each head through a camera; see `schedule/visibility.py`. @param {Head[]} heads @param {Camera} camera @returns {Sight[]} */
function look(heads, camera) {
  const { width, height } = camera;
  const projection = clipFromWorld(camera);
  const seen = heads.map((head) => {
    const matrix = multiply(projection, head.matrix);
    const isSound = matrix.every(Number.isFinite);
    const { bounds_min_m: low, bounds_max_m: high } = head.box;
    // The ellipsoid is the image of the unit ball; rows x, y and w see its centre and its axes.
    const rows = [0, 1, 3].map((row) => (isSound ? matrix.slice(4 * row, 4 * row + 4) : [0, 0, 0, 0]));
    const centre = rows.map((row) => row[3] + [0, 1, 2].reduce((sum, axis) => sum + (row[axis] * (low[axis] + high[axis])) / 2, 0));
    const axes = rows.map((row) => [0, 1, 2].map((axis) => (row[axis] * (high[axis] - low[axis])) / 2));
    const reach = Math.hypot(...axes[2]);
    /** @param {number} i @param {number} j */
    const conic = (i, j) => centre[i] * centre[j] - axes[i].reduce((sum, value, axis) => sum + value * axes[j][axis], 0);
    const scale = conic(2, 2);
    const [x, y] = [conic(0, 2) / scale, conic(1, 2) / scale];
    const a = Math.sqrt(Math.max(x * x - conic(0, 0) / scale, 1e-30));
    const b = (x * y - conic(0, 1) / scale) / a;
    const c = Math.sqrt(Math.max(y * y - conic(1, 1) / scale - b * b, 1e-30));
    return { depth: centre[2], isBefore: centre[2] + reach > NEAR_M, isOutlined: centre[2] - reach > NEAR_M, x, y, a, b, c };
  });
  const outlined = seen.filter(({ isOutlined }) => isOutlined);
  return seen.map((own) => {
    if (!own.isOutlined) {
      return own.isBefore ? { visiblePx: width * height, headPx: height, numViews: 1 } : NOTHING;
    }
    let [numOnScreen, numSeen] = [0, 0];
    for (const [u, v] of DISC) {
      const [x, y] = [own.x + own.a * u, own.y + own.b * u + own.c * v];
      if (Math.abs(x) > 1 || Math.abs(y) > 1) {
        continue;
      }
      ++numOnScreen;
      const isHidden = outlined.some((hider) => {
        const across = (x - hider.x) / hider.a;
        const up = (y - hider.y - hider.b * across) / hider.c;
        return own.depth > hider.depth && across * across + up * up <= HIDER_SIZE ** 2;
      });
      numSeen += isHidden ? 0 : 1;
    }
    const visiblePx = ((Math.PI / 4) * width * height * own.a * own.c * numSeen) / NUM_POINTS;
    const isSeen = numSeen > (1 - HIDDEN_SHARE) * numOnScreen && visiblePx >= LEAST_PX;
    return isSeen ? { visiblePx, headPx: Math.hypot(own.b, own.c) * height, numViews: 1 } : NOTHING;
  });
}

/** Plans frame after frame. */
export class Scheduler {
  constructor() {
    this.costs = new CostModel();
    this._turns = 0;
    this.isShort = false;
    this._sinceS = 0;
    this._now = -Infinity;
  }

  /** Choose what everybody gets in the frame that begins now; each head is told. @param {Head[]} heads @param {number} budgetS @param {number} now */
  plan(heads, budgetS, now) {
    [this._sinceS, this._now] = [Math.min(now - this._now, LISTENER_S), now];
    const seen = heads.filter(({ sight }) => sight.numViews > 0);
    // What a head has counts as height: two who sway side by side must not change places.
    const heights = new Map(seen.map((head) => [head, head.sight.headPx * STEP ** (head.choice ? head.levels.indexOf(head.choice.level) : 0)]));
    seen.sort((a, b) => (heights.get(a) ?? 0) - (heights.get(b) ?? 0) || compare(a.slot, b.slot));
    const shrinks = this._fit(seen, budgetS);
    let spentS = this._drawS(seen, shrinks);
    let [hasDecoded, shadedPx] = [false, 0];
    const areFew = 2 * seen.filter(({ isListening }) => !isListening).length <= seen.length;
    const turns = seen.map((head, index) => ({ head, shrink: shrinks[index] }));
    turns.sort((a, b) => before(a.head.askedS, b.head.askedS) || b.head.sight.headPx - a.head.sight.headPx || compare(a.head.slot, b.head.slot));
    for (const { head, shrink } of turns) {
      head.seenS = now;
      const { levels } = head;
      const scale = scaleOf(head, shrink);
      let level = placeOf(head, shrink);
      let decode = wanted(head, levels[level], now);
      if (decode !== "none") {
        // One is decoded in any case, so that not everybody is overdue at once, and the few who speak.
        const askedS = decode === "both" ? head.latentAskedS : head.askedS;
        const isNeeded = now - askedS >= MAX_AGE_S || !hasDecoded || (areFew && !head.isListening);
        const held = head.asked ? levels.indexOf(head.asked.level) : level;
        const decodeS = this.costs.decodeS(levels[level], decode);
        if (isNeeded || held > level || spentS + decodeS <= budgetS) {
          spentS += decodeS;
          hasDecoded = true;
        } else {
          [decode, level] = ["none", held];
        }
      }
      shadedPx += scale ** 2 * head.sight.visiblePx;
      head.choice = { level: levels[level], decode, scale, every: this._every(head) };
    }
    for (const head of heads) {
      if (!head.sight.numViews) {
        head.seenS ??= now;
        const level = head.asked?.level ?? head.levels[0];
        head.choice = { level, decode: "none", scale: 1, every: now - head.seenS < STREAM_HOLD_S ? 1 : 0 };
      }
    }
    return { costS: spentS, isShort: this.isShort, shadedPx };
  }

  /** How many times smaller each head must count, the lowest first. @param {Head[]} seen @param {number} budgetS */
  _fit(seen, budgetS) {
    /** @param {number} turns */
    const costS = (turns) => {
      const shrinks = shrinksOf(seen.length, turns);
      const decodesS = seen.reduce((sum, head, index) => {
        const level = head.levels[placeOf(head, shrinks[index])];
        return sum + this._share(head) * this.costs.decodeS(level, "both");
      }, 0);
      return this._drawS(seen, shrinks) + decodesS;
    };
    const wasShort = this.isShort;
    this.isShort = false;
    this.isShort = costS(0) > budgetS * (wasShort ? RAISE_RATIO : 1);
    const most = seen.length * MOST_TURNS;
    this._turns = Math.min(this._turns, most);
    while (this._turns > 0 && costS(this._turns - 1) < RAISE_RATIO * budgetS) {
      --this._turns;
    }
    while (this._turns < most && costS(this._turns) > budgetS) {
      ++this._turns;
    }
    return shrinksOf(seen.length, this._turns);
  }

  /** The share of images in which a head is drawn. @param {Head} head */
  _share(head) {
    return Math.min(this._sinceS / (this.isShort && head.isListening ? LISTENER_S : FACE_S), 1);
  }

  /** Which frames of its stream are wanted. @param {Head} head @returns {1 | 2 | 4} */
  _every(head) {
    const { headPx } = head.sight;
    const every = headPx < SHARE_PX[0] ? 4 : headPx < SHARE_PX[1] ? 2 : 1;
    return every === 1 && this.isShort && head.isListening ? 2 : every;
  }

  /** Seconds an image, on average, that drawing takes. @param {Head[]} seen @param {number[]} shrinks */
  _drawS(seen, shrinks) {
    const [frameS, triangleS, pixelS] = this.costs.draw;
    return seen.reduce((sum, head, index) => {
      const triangles = head.sight.numViews * head.numTriangles[placeOf(head, shrinks[index])];
      const pixels = scaleOf(head, shrinks[index]) ** 2 * head.sight.visiblePx;
      return sum + this._share(head) * (pixelS * pixels + triangleS * triangles);
    }, seen.length ? frameS : 0);
  }
}

/** What decoding and drawing cost on this machine, learned while they are done; see `schedule/cost_model.py`. */
export class CostModel {
  constructor() {
    /** Seconds of a frame, of a triangle and of a pixel. */
    this.draw = EXPECTED_DRAW_S;
    /** @type {Map<string, {level: number, parts: Decode, window: number[]}>} */
    this._decodes = new Map();
    this._slowness = 1;
    this._gram = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    this._sums = [0, 0, 0];
    /** @type {number[]} */
    this._ratios = [];
  }

  /** @param {number} level @param {Decode} parts @param {number} seconds */
  observeDecode(level, parts, seconds) {
    if (!(seconds >= MIN_SECONDS && seconds <= MAX_SECONDS)) {
      return;
    }
    const key = `${level} ${parts}`;
    const entry = this._decodes.get(key) ?? { level, parts, window: [] };
    this._decodes.set(key, entry);
    entry.window = [...entry.window, seconds].slice(-WINDOW);
    this._slowness = median([...this._decodes.values()].map((each) => median(each.window) / expectedDecodeS(each.level, each.parts)));
  }

  /** @param {number} level @param {Decode} parts */
  decodeS(level, parts) {
    const known = this._decodes.get(`${level} ${parts}`);
    return known ? median(known.window) : this._slowness * expectedDecodeS(level, parts);
  }

  /** @param {number} triangles @param {number} pixels @param {number} seconds */
  observeDraw(triangles, pixels, seconds) {
    const isPlausible = triangles >= 0 && triangles < 1e9 && pixels >= 0 && pixels < 1e9;
    if (!(isPlausible && seconds >= MIN_SECONDS && seconds <= MAX_SECONDS)) {
      return;
    }
    const counts = [1, triangles, pixels];
    const expectedS = counts.reduce((sum, count, k) => sum + count * this.draw[k], 0) || MIN_SECONDS;
    this._ratios = [...this._ratios, seconds / expectedS].slice(-GUARD);
    const usualS = median(this._ratios) * expectedS;
    const takenS = usualS / SPIKE <= seconds && seconds <= usualS * SPIKE ? seconds : usualS;
    // Relative errors count, seen from the expected.
    const scaled = counts.map((count, k) => count * EXPECTED_DRAW_S[k]);
    const usual = scaled.reduce((a, b) => a + b);
    const row = scaled.map((value) => value / usual);
    this._gram = this._gram.map((line, i) => line.map((value, j) => FADE * value + row[i] * row[j]));
    this._sums = this._sums.map((value, i) => FADE * value + row[i] * (takenS / usual));
    this.draw = this._multiples().map((value, k) => value * EXPECTED_DRAW_S[k]);
  }

  /** Least squares with a weak pull of each towards 1; what would be negative is 0. */
  _multiples() {
    const pull = [0, 1, 2].map((k) => PRIOR_WEIGHT * this._gram[k][k] + 1e-12);
    let kept = [0, 1, 2];
    while (kept.length) {
      const found = solve(
        kept.map((i) => kept.map((j) => this._gram[i][j] + (i === j ? pull[i] : 0))),
        kept.map((i) => this._sums[i] + pull[i]),
      );
      const least = Math.min(...found);
      if (least >= 0) {
        return [0, 1, 2].map((k) => found[kept.indexOf(k)] ?? 0);
      }
      kept = kept.filter((_, place) => place !== found.indexOf(least));
    }
    return [0, 0, 0];
  }
}

/** Which of an avatar's levels a head gets. @param {Head} head @param {number} shrink */
function placeOf({ levels, asked, sight }, shrink) {
  const held = asked ? levels.indexOf(asked.level) : 0;
  const height = sight.headPx / shrink;
  const reached = DETAIL_PX.filter((least, number) => height >= least * (number < held ? KEEP_RATIO : 1));
  return Math.min(reached.length, levels.length - 1);
}

/** The share of the resolution that a head is drawn with. @param {Head} head @param {number} shrink */
function scaleOf({ choice, sight }, shrink) {
  const earlier = choice?.scale ?? 1;
  const height = Math.max(sight.headPx, 1e-3);
  const excess = Math.max((shrink * Math.min(height, DETAIL_PX[0])) / height, 1);
  return SCALES.find((scale) => scale * excess >= (scale >= earlier ? KEEP_RATIO : 1)) ?? 1;
}

/** What to decode at a level. @param {Head} head @param {number} level @param {number} now @returns {Decode} */
function wanted(head, level, now) {
  if (head.asked?.level !== level) {
    return "both";
  }
  // Turning asks for expression maps again and again: they do not make the latent newer.
  const isOld = now - head.latentAskedS >= MAX_AGE_S / 2;
  if (head.latentChange > (isOld ? 0 : LEAST_CHANGE)) {
    return "both";
  }
  return head.viewTurnRad > LEAST_TURN_RAD ? "expression" : "none";
}

/** How many times smaller heads count after so many turns, the lowest first. @param {number} count @param {number} turns */
const shrinksOf = (count, turns) => Array.from({ length: count }, (_, rank) => STEP ** Math.floor((turns + count - 1 - rank) / count));
/** @param {number} level @param {Decode} parts */
const expectedDecodeS = (level, parts) => EXPECTED_DECODE_S[parts][level];
/** @param {number} a @param {number} b */
const before = (a, b) => (a === b ? 0 : a - b);
/** @param {string} a @param {string} b */
const compare = (a, b) => (a < b ? -1 : a > b ? 1 : 0);

/** @param {number[]} values */
function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

/** Solve a small positive definite system. @param {number[][]} matrix @param {number[]} values */
function solve(matrix, values) {
  const rows = matrix.map((row, k) => [...row, values[k]]);
  rows.forEach((pivot, k) => {
    for (const row of rows.filter((each) => each !== pivot)) {
      const share = row[k] / pivot[k];
      row.forEach((_, column) => (row[column] -= share * pivot[column]));
    }
  });
  return rows.map((row, k) => row[rows.length] / row[k]);
}
