/**
 * Shader text: the files of the Python package, composed as `render/gpu_program.py` does, in GLSL ES
 * 3.00; and the weights of the pixel decoder for its uniform block (`render/gpu_tables.py`).
 *
 * The files come from the relay in one answer, `shaders.json`: texts by their names.
 */

/** @import { Avatar, Spec } from "./avatar.js" */
/** @typedef {Record<string, string>} Texts */
/** @typedef {Record<string, string | number>} Defines */

export const AXIS_ROW = 1024;
const KINDS = ["float", "int", "sampler2D", "sampler2DArray", "usampler2DArray"];
/** @type {Record<string, string>} */
const CODES = {
  joint: "joint_code(uv, reach)",
  axes: "axis_codes(uv, reach)",
  uv: "vec4(2.0 * uv - 1.0, 0.0, 0.0)",
  sinusoids: Array.from({ length: 10 }, (_, k) => `octave_code(uv, reach, ${k}.0)`).join(", "),
};
/** What the pixel decoder is told of a place, by the name of its encoding, with its channels. */
export const ENCODINGS = /** @type {Record<string, [string, number][]>} */ ({
  full: [["joint", 4], ["axes", 4]],
  none: [],
  uv: [["uv", 2]],
  sinusoids: [["sinusoids", 40]],
  joint: [["joint", 4]],
  axes: [["axes", 4]],
});

/**
 * Compose the text of one shader.
 * @param {Texts} texts The files, and generated texts to include, by name.
 * @param {string} name
 * @param {Defines} [defines]
 */
export function compose(texts, name, defines = {}) {
  /** @param {string} file @returns {string} */
  const included = (file) => {
    const text = texts[file];
    if (text === undefined) {
      throw new Error(`shader ${file} is missing on the relay`);
    }
    return text.replace(/^#include "([^"]*)".*$/gm, (_, other) => included(other));
  };
  const header = KINDS.map((kind) => `precision highp ${kind};`);
  const sizes = Object.entries(defines).map(([key, value]) => `#define ${key} ${value}`.trimEnd());
  return ["#version 300 es", ...header, ...sizes, included(name)].join("\n");
}

/** Levels of a table: each has half the entries of the one before. @param {number} count */
export function axisLevels(count) {
  return 33 - Math.clz32(count - 1);
}

/** What the pixel decoder's text depends on. @param {Spec} spec @returns {Defines} */
export function specDefines(spec) {
  const levels = axisLevels(spec.axis_encoding_size);
  return {
    AXIS_SIZE: spec.axis_encoding_size,
    AXIS_ROW,
    AXIS_LEVELS: levels,
    AXIS_STRIDE: 1 << (levels - 1),
    LOG2_AXIS_SIZE: Math.log2(spec.axis_encoding_size).toFixed(6),
    LOG2_UV_SIZE: Math.log2(spec.uv_encoding_size).toFixed(6),
    SURFACE_CODES: (ENCODINGS[spec.encoding] ?? []).map(([part]) => `, ${CODES[part]}`).join(""),
  };
}

/** Name, inputs and outputs of each sine layer: of the xyz code, then of the pixel decoder. @param {Spec} spec @returns {[string, number, number][]} */
export function sineLayers(spec) {
  const channels = (ENCODINGS[spec.encoding] ?? []).reduce((sum, [, count]) => sum + count, 0);
  /** @type {[string, number, number][]} */
  const layers = [];
  for (const [prefix, first, widths] of /** @type {[string, number, number[]][]} */ ([
    ["xyz", 3, [4, 4]],
    ["pixel", 8 + channels, [8, 8, 8, 3]],
  ])) {
    let inputs = first;
    widths.forEach((outputs, index) => {
      layers.push([`${prefix}.${index}`, inputs, outputs]);
      inputs = outputs;
    });
  }
  return layers;
}

/** Texels of four that so many channels fill. @param {number} channels */
export const vectors = (channels) => Math.ceil(channels / 4);

/** sin(2 pi s) over a quarter turn either way as an odd polynomial (`gpu_tables.SINE_COEFFICIENTS`). */
const SINE = [6.283164044063381, -41.33714233439381, 81.34076751798747, -70.99341896675098];

/** A constant of GLSL. @param {string} kind @param {ArrayLike<number>} values */
const constant = (kind, values) => `${kind}(${Array.from(values, (value) => value.toExponential(8)).join(", ")})`;

/** Weights whose sums are quarter turns ahead, in turns. @param {Avatar} avatar @param {string} name @param {number} sum Of a bias. */
function inTurns(avatar, name, sum) {
  return avatar.floats(name).map((value) => value / (2 * Math.PI) + sum);
}

/**
 * Both sine networks, layer by layer, without loops. Weights stand in a uniform block, or, of an
 * avatar, as constants in turns, which machines without a circuit for sines draw faster.
 * @param {Spec} spec @param {Avatar | null} [avatar]
 */
export function sirenSource(spec, avatar = null) {
  const sizes = sineLayers(spec).map(([, ins, outs]) => [vectors(ins), vectors(outs)]);
  const matrices = sizes.reduce((sum, [ins, outs]) => sum + ins * outs, 0);
  const biases = sizes.reduce((sum, [, outs]) => sum + outs, 0);
  const block = ["layout(std140) uniform Weights {", `    mat4 matrices[${matrices}];`, `    vec4 biases[${biases}];`, "};"];
  const [a, b, c, d] = SINE.map((value) => value.toExponential(8));
  const turns = [
    "vec4 sine_of_turns(vec4 turns) {",
    "    vec4 s = 0.25 - abs(fract(turns) - 0.5);",
    "    vec4 q = s * s;",
    `    return s * (${a} + q * (${b} + q * (${c} + q * ${d})));`,
    "}",
  ];
  const lines = avatar ? turns : block;
  const [sine, weights] = avatar ? ["sine_of_turns", packWeights(avatar, true)] : ["sin", null];
  /** @param {number} index */
  const matrixOf = (index) => (weights ? constant("mat4", weights.subarray(16 * index, 16 * index + 16)) : `matrices[${index}]`);
  /** @param {number} index */
  const biasOf = (index) => (weights ? constant("vec4", weights.subarray(16 * matrices + 4 * index, 16 * matrices + 4 * index + 4)) : `biases[${index}]`);
  let matrix = 0;
  let bias = 0;
  /** @param {string} head @param {string[]} values @param {number[][]} layers @param {string} result */
  const network = (head, values, layers, result) => {
    lines.push(`${head} {`);
    layers.forEach(([, count], index) => {
      const isLast = result !== "" && index + 1 === layers.length;
      const outputs = Array.from({ length: count }, (_, number) => `h${index}_${number}`);
      for (const name of outputs) {
        const terms = values.map((value) => `${matrixOf(matrix++)} * ${value}`);
        const total = [biasOf(bias++), ...terms].join(" + ");
        lines.push(`    vec4 ${name} = ${isLast ? total : `${sine}(${total})`};`);
      }
      values = outputs;
    });
    lines.push(`    return ${values[0]}${result};`, "}");
  };
  const inputs = Array.from({ length: sizes[2][0] }, (_, index) => `p${index}`);
  const parameters = inputs.map((name) => `vec4 ${name}`).join(", ");
  network("vec4 encode_xyz(vec3 xyz_m)", ["vec4(xyz_m, 0.0)"], sizes.slice(0, 2), "");
  network(`vec3 decode_pixel(${parameters})`, inputs, sizes.slice(2), ".rgb");
  return lines.join("\n");
}

/**
 * A matrix `[out, in]` as `[out / 4, in / 4, 4 inputs, 4 outputs]`, padded with zeros.
 * @param {Float32Array} weight @param {number} outs @param {number} ins
 */
export function blocks(weight, outs, ins) {
  const across = vectors(ins);
  const found = new Float32Array(vectors(outs) * across * 16);
  for (let out = 0; out < outs; ++out) {
    for (let from = 0; from < ins; ++from) {
      const tile = (out >> 2) * across + (from >> 2);
      found[16 * tile + 4 * (from & 3) + (out & 3)] = weight[out * ins + from];
    }
  }
  return found;
}

/** Both networks' weights for the block: all matrices, then all biases; those of sines in turns. @param {Avatar} avatar @param {boolean} [hasTurns] */
export function packWeights(avatar, hasTurns = false) {
  const layers = sineLayers(avatar.spec);
  /** @param {string} name @param {number} index @param {number} ahead */
  const read = (name, index, ahead) => (hasTurns && index + 1 < layers.length ? inTurns(avatar, name, ahead) : avatar.floats(name));
  const parts = layers.map(([name, ins, outs], index) => blocks(read(`${name}.weight`, index, 0), outs, ins));
  layers.forEach(([name, , outs], index) => {
    const bias = new Float32Array(4 * vectors(outs));
    bias.set(read(`${name}.bias`, index, 0.25));
    parts.push(bias);
  });
  return joined(parts);
}

/** One array of all. @param {Float32Array[]} parts */
export function joined(parts) {
  const found = new Float32Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    found.set(part, at);
    at += part.length;
  }
  return found;
}
