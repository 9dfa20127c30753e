/**
 * The pixel decoder's text: its networks layer by layer, without loops, with an avatar's weights as
 * constants (`render/gpu_tables.py`); and how shaders want matrices.
 */

import { SINE_LAYERS } from "./avatar.js";

export const AXIS_ROW = 1024;
/** sin(2 pi s) over a quarter turn either way as an odd polynomial of s. */
const SINE = [6.283164044063381, -41.33714233439381, 81.34076751798747, -70.99341896675098];

/** Texels of four that so many channels fill. @param {number} channels */
export const vectors = (channels) => Math.ceil(channels / 4);

/** Numbers at other places of a larger array, zeros between.
 * @param {Float32Array} numbers @param {number} size @param {(at: number) => number} placeOf */
export function scattered(numbers, size, placeOf) {
  const found = new Float32Array(size);
  numbers.forEach((value, at) => (found[placeOf(at)] = value));
  return found;
}

/** A matrix `[out, in]` as `[out / 4, in / 4, 4 inputs, 4 outputs]`, padded with zeros.
 * @param {Float32Array} matrix @param {number} outs @param {number} ins */
export function blocks(matrix, outs, ins) {
  const across = vectors(ins);
  return scattered(matrix, vectors(outs) * across * 16, (at) => {
    const [out, from] = [Math.floor(at / ins), at % ins];
    return 16 * ((out >> 2) * across + (from >> 2)) + 4 * (from & 3) + (out & 3);
  });
}

/** Levels of a table: each has half the entries of the one before. @param {number} count */
export const axisLevels = (count) => 33 - Math.clz32(count - 1);

/** What the pixel decoder's text is told of an avatar. @param {Avatar} avatar */
export function pixelDefines(avatar) {
  const [axisSize, uvSize] = [avatar.shape("u_encoding")[0], avatar.shape("uv_encoding")[0]];
  return {
    AXIS_SIZE: axisSize,
    AXIS_ROW,
    AXIS_LEVELS: axisLevels(axisSize),
    AXIS_STRIDE: 1 << (axisLevels(axisSize) - 1),
    LOG2_AXIS_SIZE: Math.log2(axisSize).toFixed(6),
    LOG2_UV_SIZE: Math.log2(uvSize).toFixed(6),
    SURFACE_CODES: ", joint_code(uv, reach), axis_codes(uv, reach)",
    FILTERED: "",
  };
}

/** Both sine networks. Their numbers are in turns, a quarter ahead, for machines without a circuit
 * for sines. @param {Avatar} avatar */
export function sirenSource(avatar) {
  const [a, b, c, d] = SINE.map((value) => value.toExponential(8));
  /** @type {(type: string, values: ArrayLike<number>) => string} */
  const constant = (type, values) =>
    `${type}(${Array.from(values, (value) => value.toExponential(8)).join(", ")})`;
  /** @type {(head: string, inputs: string[], layers: typeof SINE_LAYERS, result: string) =>
   * string[]} */
  const network = (head, inputs, layers, result) => {
    const lines = [`${head} {`];
    let values = inputs;
    for (const [name, ins, outs] of layers) {
      const isLast = name === "pixel.3";
      const turn = isLast ? 1 : 2 * Math.PI;
      /** @param {string} part @param {number} size */
      const inTurns = (part, size) => avatar.floats(`${name}.${part}`, size)
        .map((value) => value / turn);
      const weight = blocks(inTurns("weight", outs * ins), outs, ins);
      const bias = new Float32Array(4 * vectors(outs));
      bias.set(inTurns("bias", outs).map((value) => value + (isLast ? 0 : 0.25)));
      values = Array.from({ length: vectors(outs) }, (_, row) => {
        const terms = values.map((value, column) => {
          const at = 16 * (row * values.length + column);
          return `${constant("mat4", weight.subarray(at, at + 16))} * ${value}`;
        });
        const sum = [constant("vec4", bias.subarray(4 * row, 4 * row + 4)), ...terms].join(" + ");
        const output = `h${name.replace(".", "")}_${row}`;
        lines.push(`    vec4 ${output} = ${isLast ? sum : `sine_of_turns(${sum})`};`);
        return output;
      });
    }
    return [...lines, `    return ${values[0]}${result};`, "}"];
  };
  return [
    "vec4 sine_of_turns(vec4 turns) {",
    "    vec4 s = 0.25 - abs(fract(turns) - 0.5);",
    "    vec4 q = s * s;",
    `    return s * (${a} + q * (${b} + q * (${c} + q * ${d})));`,
    "}",
    ...network("vec4 encode_xyz(vec3 xyz_m)", ["vec4(xyz_m, 0.0)"], SINE_LAYERS.slice(0, 2), ""),
    ...network("vec3 decode_pixel(vec4 p0, vec4 p1, vec4 p2, vec4 p3)", ["p0", "p1", "p2", "p3"],
      SINE_LAYERS.slice(2), ".rgb"),
  ].join("\n");
}
