/**
 * Latents to maps by shaders: all heads of a frame at once, as `render/gpu_decoder.py` does it with
 * the same text. Each step is one draw for all; an avatar's numbers are a layer of each array, laid
 * out as `render/gpu_tables.py` says.
 */

import { DECODER, MAP_SIZE } from "./avatar.js";
import { UNITS } from "./gl.js";
import { blocks, joined, vectors } from "./glsl.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Graphics, Target, Texture } from "./gl.js" */
/** @typedef {{shader: string, defines: Record<string, number>, columns: number, rows: number, table: "half" | "exact"}} Pass */
/** @typedef {{trunk: Pass[], full: Pass, exits: Map<number, {steps: number, pass: Pass}>, vertices: Pass[]}} Plan */
/** @typedef {{format: import("./gl.js").Format, width: number, height: number, data: ArrayBufferView}} Numbers */
/**
 * @typedef {object} Job One head to decode.
 * @property {Avatar} avatar
 * @property {Float32Array} latent 256 numbers.
 * @property {ArrayLike<number>} view The camera seen from the head, of length 1.
 * @property {number} level
 * @property {Target | null} positions Where its vertices go; null keeps them.
 * @property {Target} codes Where its expression map goes.
 */

const COLUMNS = 1024;
const [DIRECTIONS_STEP, SHEET_STEP] = [512, 32];
const [HEAD_TEXELS, VIEW, SCALE] = [66, 64, 65];
const MAX_BATCH = 32;

/** Decodes heads of any avatars. */
export class Decoder {
  /** @param {Graphics} graphics */
  constructor(graphics) {
    this._graphics = graphics;
    /** @type {Map<string, Bank>} Keyed by plan. */
    this._banks = new Map();
    /** @type {Map<Avatar, Bank>} */
    this._homes = new Map();
  }

  /** Get ready for an avatar. @param {Avatar} avatar */
  add(avatar) {
    if (this._homes.has(avatar)) {
      return;
    }
    const { plan, arrays } = layOut(avatar);
    const shape = [plan.trunk, plan.full, [...plan.exits], plan.vertices];
    const key = JSON.stringify([shape, ...[...arrays].map(([name, { width, height }]) => [name, width, height])]);
    const bank = this._banks.get(key) ?? new Bank(this._graphics, plan);
    this._banks.set(key, bank);
    bank.add(avatar, arrays);
    this._homes.set(avatar, bank);
  }

  /** @param {Avatar} avatar */
  remove(avatar) {
    this._homes.get(avatar)?.remove(avatar);
    this._homes.delete(avatar);
  }

  /** Decode heads whose avatars were added. @param {Job[]} jobs */
  decode(jobs) {
    const { gl } = this._graphics;
    for (const flag of [gl.DEPTH_TEST, gl.CULL_FACE, gl.BLEND, gl.SCISSOR_TEST]) {
      gl.disable(flag);
    }
    for (const bank of this._banks.values()) {
      const own = jobs.filter((job) => this._homes.get(job.avatar) === bank).sort((a, b) => b.level - a.level);
      for (let start = 0; start < own.length; start += MAX_BATCH) {
        bank.decode(own.slice(start, start + MAX_BATCH));
      }
    }
  }
}

/** Avatars of one plan: their numbers, programs, and the images between. */
class Bank {
  /** @param {Graphics} graphics @param {Plan} plan */
  constructor(graphics, plan) {
    this._graphics = graphics;
    this._plan = plan;
    /** @type {Map<Avatar, {layer: number, arrays: Map<string, Numbers>}>} */
    this._avatars = new Map();
    /** @type {Map<string, ReturnType<Graphics["layered"]>>} */
    this._textures = new Map();
    this._layers = 0;
    this._capacity = 0;
    this._heads = /** @type {Texture | null} */ (null);
    this._numbers = new Float32Array(MAX_BATCH * HEAD_TEXELS * 4);
    /** @param {Pass} pass */
    const step = (pass) => new Step(graphics, pass);
    this._trunk = plan.trunk.map(step);
    this._exits = new Map([...plan.exits].map(([level, { pass }]) => [level, step(pass)]));
    this._vertices = plan.vertices.map(step);
    this._full = graphics.screen(plan.full.shader, plan.full.defines);
    this._gather = graphics.screen("decode_gather.frag");
    this._sheet = graphics.screen("decode_sheet.frag");
  }

  /** @param {Avatar} avatar @param {Map<string, Numbers>} arrays */
  add(avatar, arrays) {
    const used = new Set([...this._avatars.values()].map(({ layer }) => layer));
    let layer = 0;
    while (used.has(layer)) {
      ++layer;
    }
    this._avatars.set(avatar, { layer, arrays });
    let written = [{ layer, arrays }];
    if (layer >= this._layers) {
      this._layers = 2 * (layer + 1);
      this._textures.forEach(({ texture }) => this._graphics.gl.deleteTexture(texture));
      this._textures = new Map([...arrays].map(([name, { format, width, height }]) => [name, this._graphics.layered(format, width, height, this._layers)]));
      written = [...this._avatars.values()];
    }
    for (const each of written) {
      each.arrays.forEach(({ data }, name) => this._textures.get(name)?.write(each.layer, data));
    }
  }

  /** @param {Avatar} avatar */
  remove(avatar) {
    this._avatars.delete(avatar);
  }

  /** @param {Job[]} jobs Those of the full level first. */
  decode(jobs) {
    const { gl } = this._graphics;
    this._reserve(jobs.length);
    jobs.forEach(({ avatar, latent, view }, row) => {
      const start = 4 * HEAD_TEXELS * row;
      this._numbers.set(latent, start);
      this._numbers.set([view[0], view[1], view[2], this._avatars.get(avatar)?.layer ?? 0], start + 4 * VIEW);
      this._numbers[start + 4 * SCALE] = avatar.manifest.position_scale_m;
    });
    const heads = /** @type {Texture} */ (this._heads);
    this._graphics.bind(UNITS.heads, heads);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, HEAD_TEXELS, jobs.length, gl.RGBA, gl.FLOAT, this._numbers);
    this._decodeCodes(jobs);
    if (jobs.some(({ positions }) => positions)) {
      this._decodeVertices(jobs, heads);
    }
  }

  /** Go through the trunk with those who are still in it; others leave at their level. @param {Job[]} jobs */
  _decodeCodes(jobs) {
    const lengths = jobs.map(({ level }) => this._plan.exits.get(level)?.steps ?? this._trunk.length);
    for (const [number, step] of this._trunk.entries()) {
      this._array(UNITS.table, step.pass.table);
      step.draw(lengths.filter((steps) => steps > number).length);
      step.bind();
      const leaving = lengths.flatMap((steps, place) => (steps === number + 1 ? [place] : []));
      if (!leaving.length) {
        continue;
      }
      const last = this._exits.get(jobs[leaving[0]].level);
      if (last) {
        this._array(UNITS.table, last.pass.table);
        last.draw(leaving[leaving.length - 1] + 1);
        last.bind();
      }
      for (const place of leaving) {
        this._drawMap(last ? this._gather : this._full, jobs[place].codes, place);
      }
      if (leaving[0] === 0) {
        return;
      }
      step.bind();
    }
  }

  /** @param {Job[]} jobs @param {Texture} heads */
  _decodeVertices(jobs, heads) {
    this._graphics.bind(UNITS.rows, heads);
    for (const step of this._vertices) {
      this._array(UNITS.table, step.pass.table);
      step.draw(jobs.length);
      step.bind();
    }
    this._array(UNITS.basis, "basis");
    jobs.forEach(({ level, positions }, number) => {
      if (positions) {
        this._array(UNITS.places, `places ${level}`);
        this._array(UNITS.mean, `mean ${level}`);
        this._drawMap(this._sheet, positions, number);
      }
    });
  }

  /** Draw a map of a head of the batch. @param {import("./gl.js").Program} screen @param {Target} target @param {number} head */
  _drawMap(screen, target, head) {
    const { gl } = this._graphics;
    gl.useProgram(screen.program);
    gl.uniform1i(screen.at.head, head);
    this._graphics.drawScreen(screen, target);
  }

  /** @param {number} unit @param {string} name */
  _array(unit, name) {
    const found = this._textures.get(name);
    if (found) {
      this._graphics.bind(unit, found.texture, this._graphics.gl.TEXTURE_2D_ARRAY);
    }
  }

  /** Make the images between for so many heads. @param {number} count */
  _reserve(count) {
    if (count <= this._capacity) {
      return;
    }
    this._capacity = 2 ** Math.ceil(Math.log2(count));
    this._graphics.gl.deleteTexture(this._heads);
    this._heads = this._graphics.texture("RGBA32F", HEAD_TEXELS, this._capacity);
    for (const step of [...this._trunk, ...this._exits.values(), ...this._vertices]) {
      step.reserve(this._capacity);
    }
  }
}

/** One pass over all heads, and the images that it draws. */
class Step {
  /** @param {Graphics} graphics @param {Pass} pass */
  constructor(graphics, pass) {
    this._graphics = graphics;
    this.pass = pass;
    this._screen = graphics.screen(pass.shader, pass.defines);
    /** @type {Texture[]} */
    this._images = [];
    this._target = /** @type {Target | null} */ (null);
  }

  /** @param {number} capacity Heads. */
  reserve(capacity) {
    const { gl, exact } = this._graphics;
    this._images.forEach((image) => gl.deleteTexture(image));
    gl.deleteFramebuffer(this._target?.framebuffer ?? null);
    const count = this.pass.shader === "decode_dense.frag" ? 1 : 4;
    const size = /** @type {const} */ ([this.pass.columns, capacity * this.pass.rows]);
    this._images = Array.from({ length: count }, () => this._graphics.texture(exact, ...size));
    this._target = this._graphics.target(this._images);
  }

  /** Let others read what it drew. */
  bind() {
    this._images.forEach((image, unit) => this._graphics.bind(unit, image));
  }

  /** Draw the first heads, from what is bound. @param {number} count */
  draw(count) {
    const target = /** @type {Target} */ (this._target);
    this._graphics.drawScreen(this._screen, { ...target, height: count * this.pass.rows });
  }
}

/** Texels that are added one after the other. */
class Table {
  constructor() {
    /** @type {Float32Array[]} */
    this._parts = [];
    this._length = 0;
  }

  /** Add texels of four; where they begin. @param {Float32Array} texels */
  add(texels) {
    const start = this._length;
    this._parts.push(texels);
    this._length += texels.length / 4;
    return start;
  }

  /** @param {import("./gl.js").Format} format @returns {Numbers} */
  numbers(format) {
    const height = Math.ceil(this._length / COLUMNS);
    const data = new Float32Array(4 * COLUMNS * height);
    data.set(joined(this._parts));
    return { format, width: COLUMNS, height, data };
  }
}

/** An avatar's steps and numbers. @param {Avatar} avatar @returns {{plan: Plan, arrays: Map<string, Numbers>}} */
export function layOut(avatar) {
  const [half, exact] = [new Table(), new Table()];
  /** @type {Pass[]} */
  const trunk = [];
  DECODER.forEach(([, outs], index) => {
    const [size, name] = [8 << index, `expression.${index}`];
    trunk.push(convolution(avatar, `${name}.first.weight`, `${name}.first_bias.weight`, half, "half", index === 0 ? { FIRST: 1 } : {}));
    trunk.push({
      shader: 2 * size < MAP_SIZE ? "decode_expand.frag" : "decode_full.frag",
      defines: {
        SIZE: size,
        IN_VECTORS: vectors(outs),
        WEIGHTS: half.add(phases(avatar.floats(`${name}.expand.weight`), outs, outs)),
        BIAS: half.add(phases(avatar.floats(`${name}.expand.bias`), outs, 0)),
      },
      columns: vectors(outs) * size,
      rows: size,
      table: "half",
    });
  });
  const full = /** @type {Pass} */ (trunk.pop());
  const exits = new Map(avatar.levels.slice(0, -1).map((level) => {
    const name = `level.${level}.expression`;
    const steps = trunk.findIndex((pass) => pass.defines.SIZE === level);
    /** @type {Record<string, number>} */
    const defines = {};
    const pass = convolution(avatar, `${name}.weight`, `${name}.bias`, exact, "exact", defines);
    if (avatar.has(`${name}.local`)) {
      pass.defines.LOCAL = exact.add(localBlocks(avatar.floats(`${name}.local`), avatar.shape(`${name}.local`)));
    }
    return /** @type {[number, {steps: number, pass: Pass}]} */ ([level, { steps, pass }]);
  }));
  const [directions, bases] = avatar.shape("linear.mix");
  const room = Math.ceil(directions / DIRECTIONS_STEP) * DIRECTIONS_STEP;
  const bias = new Float32Array(4 * vectors(bases));
  bias.set(avatar.floats("linear.bias"));
  /** @type {Pass} */
  const weights = {
    shader: "decode_dense.frag",
    defines: { IN_VECTORS: 64, WEIGHTS: exact.add(blocks(avatar.floats("linear.weight"), bases, 256)), BIAS: exact.add(bias) },
    columns: vectors(bases),
    rows: 1,
    table: "exact",
  };
  const mix = new Float32Array(room * bases);
  mix.set(avatar.floats("linear.mix"));
  /** @type {Pass} */
  const spread = {
    shader: "decode_dense.frag",
    defines: { IN_VECTORS: vectors(bases), WEIGHTS: half.add(blocks(mix, room, bases)) },
    columns: vectors(room),
    rows: 1,
    table: "half",
  };
  const basis = new Uint8Array(room * MAP_SIZE * 3).fill(128);
  avatar.floats("linear.basis").forEach((value, at) => (basis[at] = Math.round(value * 127) + 128));
  const arrays = new Map([
    ["half", half.numbers("RGBA16F")],
    ["exact", exact.numbers("RGBA32F")],
    ["basis", /** @type {Numbers} */ ({ format: "RGB8", width: MAP_SIZE, height: room, data: basis })],
    ...avatar.levels.flatMap((level) => sheet(avatar, level)),
  ]);
  return { plan: { trunk, full, exits, vertices: [weights, spread] }, arrays };
}

/** Places and means of a level's vertices. @param {Avatar} avatar @param {number} level @returns {[string, Numbers][]} */
function sheet(avatar, level) {
  const rank = avatar.integers("linear.rank");
  const ends = Array.from(rank);
  ends.forEach((_, row) => (ends[row] += row ? ends[row - 1] : 0));
  const vertices = avatar.sheetVertices(level);
  const rows = Math.ceil(vertices.length / level);
  const height = Math.ceil(rows / SHEET_STEP) * SHEET_STEP;
  const [places, mean] = [new Uint16Array(3 * level * height), new Float32Array(3 * level * height)];
  for (let at = 0; at < rows * level; ++at) {
    // The last vertex fills its row.
    const vertex = vertices[Math.min(at, vertices.length - 1)];
    const region = Math.floor(vertex / MAP_SIZE);
    places.set([vertex % MAP_SIZE, ends[region] - rank[region], ends[region]], 3 * at);
    mean.set(avatar.restM.subarray(3 * vertex, 3 * vertex + 3), 3 * at);
  }
  return [
    [`places ${level}`, { format: "RGB16UI", width: level, height, data: places }],
    [`mean ${level}`, { format: "RGB32F", width: level, height, data: mean }],
  ];
}

/** A 3x3 convolution with a bias for each texel. @param {Avatar} avatar @param {string} weightName @param {string} biasName @param {Table} table @param {"half" | "exact"} tableName @param {Record<string, number>} defines @returns {Pass} */
function convolution(avatar, weightName, biasName, table, tableName, defines) {
  const [outs, ins] = avatar.shape(weightName);
  const size = avatar.shape(biasName)[1];
  const [weight, bias] = [avatar.floats(weightName), avatar.floats(biasName)];
  const kernels = new Float32Array(vectors(outs) * vectors(ins) * 9 * 16);
  for (let out = 0; out < outs; ++out) {
    for (let from = 0; from < ins; ++from) {
      for (let tap = 0; tap < 9; ++tap) {
        const tile = ((out >> 2) * vectors(ins) + (from >> 2)) * 9 + tap;
        kernels[16 * tile + 4 * (from & 3) + (out & 3)] = weight[(out * ins + from) * 9 + tap];
      }
    }
  }
  const texels = new Float32Array(vectors(outs) * size * size * 4);
  for (let out = 0; out < outs; ++out) {
    for (let at = 0; at < size * size; ++at) {
      texels[4 * ((out >> 2) * size * size + at) + (out & 3)] = bias[out * size * size + at];
    }
  }
  return {
    shader: "decode_convolve.frag",
    defines: {
      SIZE: size,
      IN_VECTORS: vectors(ins),
      IS_LEAKY: tableName === "half" ? 1 : 0,
      WEIGHTS: table.add(kernels),
      BIAS: table.add(texels),
      ...defines,
    },
    columns: (vectors(outs) * size) / 2,
    rows: size / 2,
    table: tableName,
  };
}

/**
 * An expansion `[4 C, ins]` as `[C / 4, ins / 4, 4 phases, 4 inputs, 4 outputs]`; its bias `[4 C]` has
 * no inputs. Channel 4 c + p becomes phase p of channel c.
 * @param {Float32Array} weight @param {number} channels @param {number} ins
 */
function phases(weight, channels, ins) {
  const [across, inner] = [Math.max(vectors(ins), 1), ins ? 4 : 1];
  const found = new Float32Array(vectors(channels) * across * 4 * inner * 4);
  for (let row = 0; row < 4 * channels; ++row) {
    const [channel, phase] = [row >> 2, row & 3];
    for (let from = 0; from < Math.max(ins, 1); ++from) {
      const tile = ((channel >> 2) * across + (from >> 2)) * 4 + phase;
      found[(tile * inner + (from & 3)) * 4 + (channel & 3)] = weight[row * Math.max(ins, 1) + from];
    }
  }
  return found;
}

/** Weights of each block of texels `[H, W, 4 * ins]` as `[H, W, ins / 4, 4 inputs, 4 outputs]`. @param {Float32Array} local @param {number[]} shape */
function localBlocks(local, [height, width, channels]) {
  const ins = channels / 4;
  const found = new Float32Array(local.length);
  for (let at = 0; at < height * width; ++at) {
    found.set(blocks(local.subarray(at * channels, (at + 1) * channels), 4, ins), at * channels);
  }
  return found;
}
