/**
 * Latents to maps by shaders: all heads of a frame at once, as `render/gpu_decoder.py` does it with
 * the same text. Each step is one draw for all; an avatar's numbers are a layer of each array, laid
 * out as `render/gpu_tables.py` says.
 */

import { DECODER, LEVELS, MAP_SIZE } from "./avatar.js";
import { NUM_LATENT } from "./latent_stream.js";
import { blocks, joined, vectors } from "./siren.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Format, Graphics, Program, Target, Texture } from "./gl.js" */
/**
 * @typedef {{shader: string, defines: Record<string, number>, columns: number, rows: number, table:
 * "half" | "exact"}} Pass */
/** @typedef {{pass: Pass, screen: Program, images: Texture[], target: Target | null}} Step */
/** @typedef {{format: Format, width: number, height: number, data: ArrayBufferView}} Numbers */
/** @typedef {ReturnType<typeof layOut>} Layout */
/** @typedef {ReturnType<typeof openDecoder>} Decoder */
/**
 * @typedef {object} Job One head to decode.
 * @property {Avatar} avatar Which was added.
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

/** Decodes heads of any avatars. @param {Graphics} graphics */
export function openDecoder(graphics) {
  const { gl } = graphics;
  /** Keyed by plan. @type {Map<string, ReturnType<typeof openBank>>} */
  const banks = new Map();
  /** @type {Map<Avatar, ReturnType<typeof openBank>>} */
  const homes = new Map();
  return {
    /** @param {Avatar} avatar */
    add(avatar) {
      if (homes.has(avatar)) return;
      const layout = layOut(avatar);
      const sizes = Object.values(layout.arrays).map(({ width, height }) => [width, height]);
      const key = JSON.stringify([layout.plan, sizes]);
      const bank = banks.get(key) ?? openBank(graphics, layout);
      banks.set(key, bank);
      homes.set(avatar, bank);
      bank.add(avatar, layout);
    },
    /** @param {Avatar} avatar */
    remove(avatar) {
      homes.get(avatar)?.avatars.delete(avatar);
      homes.delete(avatar);
    },
    /** @param {Job[]} jobs */
    decode(jobs) {
      for (const flag of [gl.DEPTH_TEST, gl.CULL_FACE, gl.BLEND, gl.SCISSOR_TEST]) gl.disable(flag);
      for (const bank of banks.values()) {
        const own = jobs.filter(({ avatar }) => bank.avatars.has(avatar))
          .sort((a, b) => b.level - a.level);
        for (let at = 0; at < own.length; at += MAX_BATCH) {
          bank.decode(own.slice(at, at + MAX_BATCH));
        }
      }
    },
  };
}

/** Avatars of one plan: their numbers, programs, and the images between.
 * @param {Graphics} graphics @param {Layout} layout */
function openBank(graphics, { plan }) {
  /** @type {Map<Avatar, {layer: number, layout: Layout}>} */
  const avatars = new Map();
  /** @type {Record<string, Texture>} */
  let arrays = {};
  let [layers, capacity] = [0, 0];
  /** @type {Texture | undefined} */
  let heads;
  const numbers = new Float32Array(MAX_BATCH * HEAD_TEXELS * 4);
  /** @param {Pass} pass @returns {Step} */
  const open = (pass) =>
    ({ pass, screen: graphics.screen(pass.shader, pass.defines), images: [], target: null });
  const trunk = plan.trunk.map(open);
  const exits = plan.exits.map(open);
  const [weights, spread] = plan.vertices.map(open);
  const full = graphics.screen(plan.full.shader, plan.full.defines);
  const gather = graphics.screen("decode_gather.frag");
  const sheet = graphics.screen("decode_sheet.frag");

  /** Write an avatar's numbers into a layer that is free. @param {Avatar} avatar
   * @param {Layout} layout */
  function add(avatar, layout) {
    const used = new Set(Array.from(avatars.values(), ({ layer }) => layer));
    let layer = 0;
    while (used.has(layer)) ++layer;
    avatars.set(avatar, { layer, layout });
    let written = [{ layer, layout }];
    if (layer >= layers) {
      layers = 2 * (layer + 1);
      graphics.free(...Object.values(arrays));
      arrays = Object.fromEntries(Object.entries(layout.arrays)
        .map(([name, { format, width, height }]) =>
        [name, graphics.texture(format, width, height, { layers })]));
      written = [...avatars.values()];
    }
    for (const each of written) {
      for (const [name, { data }] of Object.entries(each.layout.arrays)) {
        graphics.write(arrays[name], data, each.layer);
      }
    }
  }

  /** Make the images between for so many heads. @param {number} count */
  function reserve(count) {
    if (count <= capacity) return;
    capacity = 2 ** Math.ceil(Math.log2(count));
    graphics.free(heads);
    heads = graphics.texture("RGBA32F", HEAD_TEXELS, capacity);
    for (const step of [...trunk, ...exits, weights, spread]) {
      graphics.free(step.target, ...step.images);
      const { shader, columns, rows } = step.pass;
      const images = Array.from({ length: shader === "decode_dense.frag" ? 1 : 4 }, () =>
        graphics.texture(graphics.exact, columns, capacity * rows));
      Object.assign(step, { images, target: graphics.target(images) });
    }
  }

  /** What shaders read of images, whatever they call them. @param {(Texture | undefined)[]} images
   * @param {string} table */
  const inputs = ([phase0, phase1, phase2, phase3], table) =>
    ({ heads, table: arrays[table], phase0, phase1, phase2, phase3, rows: phase0 });

  /** Draw the first heads of a step; what it drew. @param {Step} step @param {number} count
   * @param {(Texture | undefined)[]} images */
  function run({ pass, screen, target, images: drawn }, count, images) {
    const all = /** @type {Target} */ (target);
    graphics.draw(screen, { ...all, height: count * pass.rows }, inputs(images, pass.table));
    return drawn;
  }

  /** Go through the trunk with those who are still in it; others leave at their level.
   * @param {Job[]} jobs */
  function decodeCodes(jobs) {
    const lengths =
      jobs.map(({ level }) => (level === MAP_SIZE ? trunk.length : 2 * Math.log2(level / 8)));
    /** @type {Texture[]} */
    let images = [];
    for (const [number, step] of trunk.entries()) {
      images = run(step, lengths.filter((length) => length > number).length, images);
      const leaving = lengths.flatMap((length, place) => (length === number + 1 ? [place] : []));
      if (!leaving.length) continue;
      const exit = exits[LEVELS.indexOf(jobs[leaving[0]].level)];
      const last = exit ? run(exit, leaving[leaving.length - 1] + 1, images) : images;
      for (const head of leaving) {
        graphics.draw(exit ? gather : full, jobs[head].codes, { ...inputs(last, "half"), head });
      }
      if (leaving[0] === 0) return;
    }
  }

  /** @param {Job[]} jobs */
  function decodeVertices(jobs) {
    const directions = run(spread, jobs.length, run(weights, jobs.length, [heads]));
    jobs.forEach(({ level, positions }, head) => {
      if (!positions) return;
      const own = { basis: arrays.basis, places: arrays[`places ${level}`],
        mean: arrays[`mean ${level}`] };
      graphics.draw(sheet, positions, { ...inputs(directions, "half"), ...own, head });
    });
  }

  /** @param {Job[]} jobs Those of the full level first. */
  function decode(jobs) {
    reserve(jobs.length);
    jobs.forEach(({ avatar, latent, view }, row) => {
      const start = 4 * HEAD_TEXELS * row;
      numbers.set(latent, start);
      numbers.set([view[0], view[1], view[2], avatars.get(avatar)?.layer ?? 0], start + 4 * VIEW);
      numbers[start + 4 * SCALE] = avatar.manifest.position_scale_m;
    });
    graphics.write(/** @type {Texture} */ (heads), numbers, 0, jobs.length);
    decodeCodes(jobs);
    if (jobs.some(({ positions }) => positions)) decodeVertices(jobs);
  }

  return { avatars, add, decode };
}

/** Texels that are added one after the other. */
function openTable() {
  /** @type {Float32Array[]} */
  const parts = [];
  let length = 0;
  return {
    /** Add texels of four; where they begin. @param {Float32Array} texels */
    add(texels) {
      const start = length;
      parts.push(texels);
      length += texels.length / 4;
      return start;
    },
    /** @param {Format} format @returns {Numbers} */
    numbers(format) {
      const height = Math.ceil(length / COLUMNS);
      const data = new Float32Array(4 * COLUMNS * height);
      data.set(joined(parts));
      return { format, width: COLUMNS, height, data };
    },
  };
}

/** An avatar's steps and numbers. @param {Avatar} avatar */
export function layOut(avatar) {
  const tables = { half: openTable(), exact: openTable() };
  /** A 3x3 convolution with a bias for each texel. @param {string} weight @param {string} bias
   * @param {number[]} shape Outputs, inputs and size. @param {"half" | "exact"} table @returns
   * {Pass} */
  const convolution = (weight, bias, [outs, ins, size], table, defines = {}) => ({
    shader: "decode_convolve.frag",
    defines: {
      SIZE: size,
      IN_VECTORS: vectors(ins),
      IS_LEAKY: table === "half" ? 1 : 0,
      WEIGHTS: tables[table].add(kernels(avatar.floats(weight, outs * ins * 9), outs, ins)),
      BIAS: tables[table].add(
        blocks(avatar.floats(bias, outs * size * size), outs, 1, size * size)),
      ...defines,
    },
    columns: (vectors(outs) * size) / 2,
    rows: size / 2,
    table,
  });
  const trunk = DECODER.flatMap(([ins, outs], index) => {
    const [size, name] = [8 << index, `expression.${index}`];
    const first = index ? {} : { FIRST: 1 };
    /** @type {Pass} */
    const expand = {
      shader: 2 * size < MAP_SIZE ? "decode_expand.frag" : "decode_full.frag",
      defines: {
        SIZE: size,
        IN_VECTORS: vectors(outs),
        WEIGHTS: tables.half.add(
          phases(avatar.floats(`${name}.expand.weight`, 4 * outs * outs), outs, outs)),
        BIAS: tables.half.add(phases(avatar.floats(`${name}.expand.bias`, 4 * outs), outs, 0)),
      },
      columns: vectors(outs) * size,
      rows: size,
      table: "half",
    };
    return [convolution(`${name}.first.weight`, `${name}.first_bias.weight`, [outs, ins, size],
      "half", first), expand];
  });
  const full = /** @type {Pass} */ (trunk.pop());
  const exits = [[64, 16], [128, 8]].map(([level, ins]) => {
    const name = `level.${level}.expression`;
    const local = level === 64
      ? { LOCAL: tables.exact.add(localBlocks(avatar.floats(`${name}.local`, 65_536))) } : {};
    return convolution(`${name}.weight`, `${name}.bias`, [4, ins, level], "exact", local);
  });
  const [directions, bases] = avatar.shape("linear.mix");
  const room = Math.ceil(directions / DIRECTIONS_STEP) * DIRECTIONS_STEP;
  const bias = new Float32Array(4 * vectors(bases));
  bias.set(avatar.floats("linear.bias", bases));
  const mix = new Float32Array(room * bases);
  mix.set(avatar.floats("linear.mix", directions * bases));
  /** @type {(ins: number, outs: number, matrix: Float32Array, table: "half" | "exact") => Pass} */
  const dense = (ins, outs, matrix, table) => ({
    shader: "decode_dense.frag",
    defines: { IN_VECTORS: vectors(ins), WEIGHTS: tables[table].add(blocks(matrix, outs, ins)) },
    columns: vectors(outs),
    rows: 1,
    table,
  });
  const weights =
    dense(NUM_LATENT, bases, avatar.floats("linear.weight", bases * NUM_LATENT), "exact");
  weights.defines.BIAS = tables.exact.add(bias);
  const vertices = [weights, dense(bases, room, mix, "half")];
  const basis = new Uint8Array(room * MAP_SIZE * 3).fill(128);
  basis.set(avatar.integers("linear.basis", directions * MAP_SIZE * 3));
  /** @type {Record<string, Numbers>} */
  const arrays = {
    half: tables.half.numbers("RGBA16F"),
    exact: tables.exact.numbers("RGBA32F"),
    basis: { format: "RGB8", width: MAP_SIZE, height: room, data: basis },
  };
  for (const level of LEVELS) Object.assign(arrays, sheetNumbers(avatar, level));
  return { plan: { trunk, full, exits, vertices }, arrays };
}

/** Places and means of a level's vertices. @param {Avatar} avatar @param {number} level @returns
 * {Record<string, Numbers>} */
function sheetNumbers(avatar, level) {
  let end = 0;
  const regions = Array.from(avatar.integers("linear.rank"), (rank) => [end, (end += rank)]);
  const vertices = avatar.sheetVertices(level);
  const rows = Math.ceil(vertices.length / level);
  const height = Math.ceil(rows / SHEET_STEP) * SHEET_STEP;
  const [places, mean] =
    [new Uint16Array(3 * level * height), new Float32Array(3 * level * height)];
  for (let at = 0; at < rows * level; ++at) {
    // The last vertex fills its row.
    const vertex = vertices[Math.min(at, vertices.length - 1)];
    places.set([vertex % MAP_SIZE, ...regions[Math.floor(vertex / MAP_SIZE)]], 3 * at);
    mean.set(avatar.restM.subarray(3 * vertex, 3 * vertex + 3), 3 * at);
  }
  return {
    [`places ${level}`]: { format: "RGB16UI", width: level, height, data: places },
    [`mean ${level}`]: { format: "RGB32F", width: level, height, data: mean },
  };
}

/** Kernels `[out, in, 9]` as `[out / 4, in / 4, 9, 4 inputs, 4 outputs]`.
 * @param {Float32Array} weight @param {number} outs @param {number} ins */
function kernels(weight, outs, ins) {
  const found = new Float32Array(vectors(outs) * vectors(ins) * 9 * 16);
  weight.forEach((value, at) => {
    const [out, from, tap] = [Math.floor(at / 9 / ins), Math.floor(at / 9) % ins, at % 9];
    const tile = ((out >> 2) * vectors(ins) + (from >> 2)) * 9 + tap;
    found[16 * tile + 4 * (from & 3) + (out & 3)] = value;
  });
  return found;
}

/**
 * An expansion `[4 C, ins]` as `[C / 4, ins / 4, 4 phases, 4 inputs, 4 outputs]`; its bias `[4 C]`
 * has no inputs. Channel 4 c + p becomes phase p of channel c.
 * @param {Float32Array} weight @param {number} channels @param {number} ins
 */
function phases(weight, channels, ins) {
  const [columns, across, inner] = [Math.max(ins, 1), Math.max(vectors(ins), 1), ins ? 4 : 1];
  const found = new Float32Array(vectors(channels) * across * 4 * inner * 4);
  weight.forEach((value, at) => {
    const [row, from] = [Math.floor(at / columns), at % columns];
    const tile = ((row >> 4) * across + (from >> 2)) * 4 + (row & 3);
    found[(tile * inner + (from & 3)) * 4 + ((row >> 2) & 3)] = value;
  });
  return found;
}

/** Weights of each block of texels `[32, 32, 64]` as `[32, 32, 4, 4 inputs, 4 outputs]`.
 * @param {Float32Array} local */
function localBlocks(local) {
  return joined(
    Array.from({ length: 1024 }, (_, at) => blocks(local.subarray(at * 64, at * 64 + 64), 4, 16)));
}
