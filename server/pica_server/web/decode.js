/**
 * Latents to maps by shaders, as `render/gpu_decoder.py` does it with the same text, but one head
 * after the other. Each step is one draw; an avatar's numbers are laid out as
 * `render/gpu_tables.py` says.
 */

import { DECODER, LEVELS, MAP_SIZE } from "./avatar.js";
import { NUM_LATENT } from "./latent_stream.js";
import { blocks, scattered, vectors } from "./siren.js";

const COLUMNS = 1024;
const [DIRECTIONS_STEP, SHEET_STEP] = [512, 32];
const [HEAD_TEXELS, VIEW, SCALE] = [66, 64, 65];
/** The file of each program, and what it is told beside sizes. */
const PROGRAMS = {
  first: ["convolve", "BIAS", "FIRST"], convolve: ["convolve", "BIAS"],
  local: ["convolve", "BIAS", "LOCAL"], expand: ["expand", "BIAS"], full: ["full", "BIAS"],
  biased: ["dense", "BIAS"], dense: ["dense"], gather: ["gather"], sheet: ["sheet"],
};
const SIZES = ["SIZE", "IN_VECTORS", "WEIGHTS", "IS_LEAKY"];

/** Decodes heads of any avatars. @param {Graphics} graphics */
export function openDecoder(graphics) {
  const { gl } = graphics;
  const heads = graphics.texture("RGBA32F", HEAD_TEXELS, 1);
  /** @type {Record<string, Program>} */
  const programs = {};
  /** What steps of one kind and size draw. @type {Map<string, Target & {images: Texture[]}>} */
  const targets = new Map();
  /** @type {Map<Avatar, {plan: Plan, arrays: Record<string, Texture>}>} */
  const avatars = new Map();

  /** Let the driver begin: programs are for all sizes and avatars. */
  function compile() {
    for (const [name, [file, ...told]] of Object.entries(PROGRAMS)) {
      const names = [...SIZES, ...told].map((each) => [each, null]);
      programs[name] ??= graphics.screen(`decode_${file}.frag`, Object.fromEntries(names));
    }
  }

  /** @param {Avatar} avatar */
  function add(avatar) {
    compile();
    if (avatars.has(avatar)) return;
    const { plan, numbers } = layOut(avatar);
    const arrays = Object.entries(numbers).map(([name, { format, width, height, data }]) =>
      [name, graphics.write(graphics.texture(format, width, height, { isArray: true }), data)]);
    avatars.set(avatar, { plan, arrays: Object.fromEntries(arrays) });
  }

  /** @param {Avatar} avatar */
  function remove(avatar) {
    graphics.free(...Object.values(avatars.get(avatar)?.arrays ?? {}));
    avatars.delete(avatar);
  }

  /** @type {(pass: Pass) => Target & {images: Texture[]}} */
  function targetOf({ program, numbers: { SIZE }, columns, rows }) {
    const key = JSON.stringify([program, columns, rows]);
    const images = targets.get(key)?.images ?? Array.from({ length: SIZE ? 4 : 1 }, () =>
      graphics.texture(graphics.exact, columns, rows));
    const target = targets.get(key) ?? { ...graphics.target(images), images };
    targets.set(key, target);
    return target;
  }

  /** @param {Job} job */
  function decodeOne({ avatar, latent, view, level, positions, codes }) {
    const { plan, arrays } =
      /** @type {{plan: Plan, arrays: Record<string, Texture>}} */ (avatars.get(avatar));
    /** What shaders read of images, whatever they call them, and are told.
     * @type {(images: Texture[], pass?: Pass) => Record<string, any>} */
    const inputs = ([phase0, phase1, phase2, phase3], pass) => ({ ...pass?.numbers, heads,
      table: arrays[pass?.table ?? "half"], phase0, phase1, phase2, phase3, rows: phase0 });
    /** @type {(steps: Pass[], images: Texture[]) => Texture[]} */
    const run = (steps, images) => steps.reduce((before, pass) => {
      const target = targetOf(pass);
      graphics.draw(programs[pass.program], target, inputs(before, pass));
      return target.images;
    }, images);
    const told = new Float32Array(4 * HEAD_TEXELS);
    told.set(latent);
    told.set([view[0], view[1], view[2]], 4 * VIEW);
    told[4 * SCALE] = avatar.manifest.position_scale_m;
    graphics.write(heads, told);
    const part = LEVELS.indexOf(level);
    const exit = plan.exits.slice(part, part + 1);
    const last = run([...plan.trunk.slice(0, part + 1).flat(), ...exit], []);
    const program = exit.length ? programs.gather : programs.full;
    graphics.draw(program, codes, { ...inputs(last, plan.full), head: 0 });
    if (!positions) return;
    graphics.draw(programs.sheet, positions, { ...inputs(run(plan.vertices, [heads])), head: 0,
      basis: arrays.basis, places: arrays[`places ${level}`], mean: arrays[`mean ${level}`] });
  }

  /** @param {Job[]} jobs */
  function decode(jobs) {
    for (const flag of [gl.DEPTH_TEST, gl.CULL_FACE, gl.BLEND, gl.SCISSOR_TEST]) gl.disable(flag);
    jobs.forEach(decodeOne);
  }

  return { compile, add, remove, decode };
}

/** An avatar's steps and numbers. @param {Avatar} avatar */
function layOut(avatar) {
  /** @type {Record<"half" | "exact", Float32Array[]>} */
  const tables = { half: [], exact: [] };
  /** Texels of four in a table. @param {Float32Array[]} table */
  const count = (table) => table.reduce((sum, texels) => sum + texels.length / 4, 0);
  /** Add texels to a table; where they begin.
   * @type {(name: "half" | "exact", texels: Float32Array) => number} */
  function add(name, texels) {
    const start = count(tables[name]);
    tables[name].push(texels);
    return start;
  }
  /** @type {(name: "half" | "exact", format: Format) => Numbers} */
  function numbers(name, format) {
    const height = Math.ceil(count(tables[name]) / COLUMNS);
    const data = new Float32Array(4 * COLUMNS * height);
    tables[name].reduce((at, texels) => {
      data.set(texels, at);
      return at + texels.length;
    }, 0);
    return { format, width: COLUMNS, height, data };
  }
  /** A 3x3 convolution of outputs, inputs and size, with a bias for each texel.
   * @type {(program: string, weight: string, bias: string, shape: number[],
   * table: "half" | "exact", more?: Record<string, number>) => Pass} */
  const convolution = (program, weight, bias, [outs, ins, size], table, more = {}) => ({
    program,
    numbers: {
      SIZE: size,
      IN_VECTORS: vectors(ins),
      IS_LEAKY: table === "half" ? 1 : 0,
      WEIGHTS: add(table, kernels(avatar.floats(weight, outs * ins * 9), outs, ins)),
      BIAS: add(table, blocks(avatar.floats(bias, outs * size ** 2), outs, size ** 2)),
      ...more,
    },
    columns: (vectors(outs) * size) / 2,
    rows: size / 2,
    table,
  });
  const steps = DECODER.flatMap(([ins, outs], index) => {
    const [size, name] = [8 << index, `expression.${index}`];
    const [weight, bias] = ["weight", "bias"].map((part) => `${name}.expand.${part}`);
    /** @type {Pass} */
    const expand = {
      program: 2 * size < MAP_SIZE ? "expand" : "full",
      numbers: {
        SIZE: size,
        IN_VECTORS: vectors(outs),
        WEIGHTS: add("half", phases(avatar.floats(weight, 4 * outs * outs), outs, outs, 4)),
        BIAS: add("half", phases(avatar.floats(bias, 4 * outs), outs, 1, 1)),
      },
      columns: vectors(outs) * size,
      rows: size,
      table: "half",
    };
    return [convolution(index ? "convolve" : "first", `${name}.first.weight`,
      `${name}.first_bias.weight`, [outs, ins, size], "half"), expand];
  });
  const exits = [[64, 16], [128, 8]].map(([level, ins]) => {
    const name = `level.${level}.expression`;
    const local = level === 64
      ? { LOCAL: add("exact", localBlocks(avatar.floats(`${name}.local`, 65_536))) } : {};
    return convolution(level === 64 ? "local" : "convolve", `${name}.weight`, `${name}.bias`,
      [4, ins, level], "exact", local);
  });
  const [directions, bases] = avatar.shape("linear.mix");
  const room = Math.ceil(directions / DIRECTIONS_STEP) * DIRECTIONS_STEP;
  const bias = new Float32Array(4 * vectors(bases));
  bias.set(avatar.floats("linear.bias", bases));
  const mix = new Float32Array(room * bases);
  mix.set(avatar.floats("linear.mix", directions * bases));
  /** @type {(program: string, ins: number, outs: number, matrix: Float32Array,
   * table: "half" | "exact", more?: Record<string, number>) => Pass} */
  const dense = (program, ins, outs, matrix, table, more = {}) => ({
    program,
    numbers: { IN_VECTORS: vectors(ins), WEIGHTS: add(table, blocks(matrix, outs, ins)),
      ...more },
    columns: vectors(outs),
    rows: 1,
    table,
  });
  const linear = avatar.floats("linear.weight", bases * NUM_LATENT);
  const vertices = [
    dense("biased", NUM_LATENT, bases, linear, "exact", { BIAS: add("exact", bias) }),
    dense("dense", bases, room, mix, "half"),
  ];
  const basis = new Uint8Array(room * MAP_SIZE * 3).fill(128);
  basis.set(avatar.integers("linear.basis", directions * MAP_SIZE * 3));
  /** @type {Record<string, Numbers>} */
  const all = {
    half: numbers("half", "RGBA16F"),
    exact: numbers("exact", "RGBA32F"),
    basis: { format: "RGB8", width: MAP_SIZE, height: room, data: basis },
  };
  for (const level of LEVELS) Object.assign(all, sheetNumbers(avatar, level));
  const trunk = [steps.slice(0, 6), steps.slice(6, 8), steps.slice(8, 9)]; // up to each level
  return { plan: { trunk, exits, full: steps[9], vertices }, numbers: all };
}

/** Places and means of a level's vertices.
 * @type {(avatar: Avatar, level: number) => Record<string, Numbers>} */
function sheetNumbers(avatar, level) {
  let end = 0;
  const regions = Array.from(avatar.rank, (rank) => [end, (end += rank)]);
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
  return scattered(weight, vectors(outs) * vectors(ins) * 9 * 16, (at) => {
    const [out, from, tap] = [Math.floor(at / 9 / ins), Math.floor(at / 9) % ins, at % 9];
    const tile = ((out >> 2) * vectors(ins) + (from >> 2)) * 9 + tap;
    return 16 * tile + 4 * (from & 3) + (out & 3);
  });
}

/**
 * An expansion `[4 C, ins]` as `[C / 4, ins / 4, 4 phases, 4 inputs, 4 outputs]`; a bias has one
 * input, and a tile of 1. Channel 4 c + p becomes phase p of channel c.
 * @type {(weight: Float32Array, channels: number, ins: number, tile: number) => Float32Array}
 */
function phases(weight, channels, ins, tile) {
  const across = vectors(ins);
  return scattered(weight, vectors(channels) * across * 16 * tile, (at) => {
    const [row, from] = [Math.floor(at / ins), at % ins];
    const place = ((row >> 4) * across + (from >> 2)) * 4 + (row & 3);
    return (place * tile + (from & 3)) * 4 + ((row >> 2) & 3);
  });
}

/** Weights of each block of texels `[32, 32, 64]` as `[32, 32, 4, 4 inputs, 4 outputs]`: of 4
 * outputs and 16 inputs. @param {Float32Array} local */
function localBlocks(local) {
  return scattered(local, local.length, (at) => {
    const [out, from] = [(at >> 4) & 3, at & 15];
    return (at & ~63) + 16 * (from >> 2) + 4 * (from & 3) + out;
  });
}
