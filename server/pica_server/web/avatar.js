/**
 * Avatar files (`.pica`): safetensors with a manifest. Read as `avatar/file.py` reads them, without
 * trust: names, shapes and sizes are checked before memory is spent.
 *
 * This page draws avatars of block G with bases, as those that ship; others say so in one line. Not
 * checked here: how far bases may move triangles over one another; shaders keep all within the box,
 * and a lost context heals.
 */

import { ENCODINGS, sineLayers } from "./glsl.js";

/** @import { Vector } from "./space.js" */
/** @typedef {{block: string, uv_encoding_size: number, axis_encoding_size: number, encoding: string, geometry: string}} Spec */
/** @typedef {{dtype: string, shape: number[], start: number, end: number}} Entry */
/**
 * @typedef {object} Manifest
 * @property {string} name
 * @property {Spec} spec
 * @property {number} position_scale_m
 * @property {Vector} bounds_min_m
 * @property {Vector} bounds_max_m
 * @property {number[]} view_span Least and most yaw, least and most pitch, degrees.
 */

export const MAX_FILE_BYTES = 64 * 2 ** 20;
export const MAP_SIZE = 256;
const MAX_HEADER_BYTES = 256 * 2 ** 10;
const [MAX_VERTICES, MAX_FACES, MAX_DIRECTIONS, MAX_BASES, MAX_COMPONENTS] = [200_000, 400_000, 8192, 128, 4e6];
const [MAX_MAGNITUDE, MAX_EXTENT_M, MAX_SCALE_M, MAX_COVER] = [1e6, 0.45, 10, 4];
const [SEAM, STATIC] = [1, 2];
/** Inputs and outputs of each block of the expression decoder. */
export const DECODER = [[7, 32], [32, 16], [16, 16], [16, 8], [8, 4]];
const ENCODER = [52, 160, 160, 256];
/** @type {Record<string, number>} */
const BYTES = { F32: 4, F16: 2, I32: 4, I16: 2, U16: 2, U8: 1 };

/** What is wrong with an avatar, in one line. */
export class AvatarError extends Error {}

/** A checked avatar. */
export class Avatar {
  /** @param {string} id @param {Manifest} manifest @param {Record<string, Entry>} entries @param {Uint8Array} data @param {Record<string, {scale: number[], offset: number[]}>} affine */
  constructor(id, manifest, entries, data, affine) {
    this.id = id;
    this.manifest = manifest;
    this.spec = manifest.spec;
    this._entries = entries;
    this._data = data;
    this._affine = affine;
    /** Map sizes that it can be decoded to, ascending. @type {number[]} */
    this.levels = "level.still" in entries ? [64, 128, MAP_SIZE] : [MAP_SIZE];
    this.vertexUv = this.floats("mesh.vertex_uv").map((value) => Math.min(Math.max(value, 0), 1));
    this.numVertices = this.vertexUv.length / 2;
    /** Where vertices are at rest, metres. */
    this.restM = this.floats("linear.mean").subarray(0, 3 * this.numVertices);
    /** @type {Map<number, Uint32Array>} */
    this._faces = new Map(this.levels.map((level) => [level, this._indices(level)]));
    this._parts = "static.parts" in entries ? this.integers("static.parts") : null;
  }

  /** @param {string} name */
  has(name) {
    return name in this._entries;
  }

  /** @param {string} name */
  shape(name) {
    return this._entries[name].shape;
  }

  /** A tensor as its file holds it. @param {string} name */
  integers(name) {
    const { dtype, start, end } = this._entries[name];
    const bytes = this._data.slice(start, end).buffer;
    switch (dtype) {
      case "I32": return new Int32Array(bytes);
      case "I16": return new Int16Array(bytes);
      case "U8": return new Uint8Array(bytes);
      case "F32": return new Float32Array(bytes);
      default: return new Uint16Array(bytes);
    }
  }

  /** A tensor as floats. @param {string} name @returns {Float32Array} */
  floats(name) {
    const { dtype, shape } = this._entries[name];
    const stored = this.integers(name);
    if (stored instanceof Float32Array) {
      return sound(name, stored);
    }
    if (dtype === "F16") {
      return sound(name, Float32Array.from(stored, halfToFloat));
    }
    const channels = shape[shape.length - 1];
    const { scale, offset } = this._affine[name] ?? {};
    for (const values of [scale, offset]) {
      if (!Array.isArray(values) || values.length !== channels || !values.every((value) => isWithin(value, -MAX_MAGNITUDE, MAX_MAGNITUDE))) {
        throw new AvatarError(`storage.${name} must be ${channels} finite numbers up to ${MAX_MAGNITUDE}`);
      }
    }
    const found = new Float32Array(stored.length);
    for (let at = 0; at < found.length; ++at) {
      const channel = at % channels;
      found[at] = offset[channel] + Math.fround(scale[channel]) * stored[at];
    }
    return sound(name, found);
  }

  /** Triangles of a level. @param {number} level */
  faces(level) {
    return /** @type {Uint32Array} */ (this._faces.get(level));
  }

  /** Those that are decoded, or those that have a texture. @param {number} level @param {"decoded" | "textured"} kind */
  facesOf(level, kind) {
    const isTextured = kind === "textured";
    return filterFaces(this.faces(level), (a, b, c) => {
      const least = Math.min(this.part(a), this.part(b), this.part(c));
      return isTextured ? least >= SEAM : least < STATIC;
    });
  }

  /** What a vertex belongs to: 0 moves, 1 is the seam, 2 has a texture. @param {number} vertex */
  part(vertex) {
    return this._parts ? Math.min((this._parts[vertex >> 2] >> (2 * (vertex & 3))) & 3, STATIC) : 0;
  }

  /** The vertices that a decode at a level makes, in the order of its sheet. @param {number} level */
  sheetVertices(level) {
    if (level === MAP_SIZE) {
      return Uint32Array.from({ length: this.numVertices }, (_, index) => index);
    }
    return Uint32Array.from(new Set(this.faces(level))).sort();
  }

  /** Width of the shoulders, and the height at which the mesh ends, metres. */
  bust() {
    let [width, lower] = [0, Infinity];
    for (const vertex of this.faces(MAP_SIZE)) {
      width = Math.max(width, Math.abs(this.restM[3 * vertex]));
      lower = Math.min(lower, this.restM[3 * vertex + 1]);
    }
    return { widthM: 2 * width, lowerM: lower };
  }

  /** @param {number} level */
  _indices(level) {
    const name = level === MAP_SIZE ? "mesh.faces" : `level.${level}.faces`;
    const found = Uint32Array.from(this.integers(name), (value) => value >>> 0);
    const most = found.reduce((a, b) => Math.max(a, b), 0);
    if (most >= this.numVertices) {
      throw new AvatarError(`tensor ${name} names vertex ${most}; allowed are 0 to ${this.numVertices - 1}`);
    }
    return found;
  }
}

/** The triangles that pass. @param {Uint32Array} faces @param {(a: number, b: number, c: number) => boolean} passes */
export function filterFaces(faces, passes) {
  const found = new Uint32Array(faces.length);
  let count = 0;
  for (let at = 0; at < faces.length; at += 3) {
    if (passes(faces[at], faces[at + 1], faces[at + 2])) {
      found.set(faces.subarray(at, at + 3), count);
      count += 3;
    }
  }
  return found.slice(0, count);
}

/**
 * Read and check an avatar.
 * @param {ArrayBuffer} bytes @param {string} id
 * @throws {AvatarError} What is wrong with it.
 */
export function openAvatar(bytes, id) {
  const data = new Uint8Array(bytes);
  const { header, start } = readHeader(data);
  const metadata = header.__metadata__ ?? {};
  delete header.__metadata__;
  if (typeof metadata.pica !== "string") {
    throw new AvatarError("it has no manifest: this is not an avatar file");
  }
  const manifest = checkManifest(parse("manifest", metadata.pica));
  const entries = checkEntries(header, start, data.length);
  checkShapes(manifest.spec, entries);
  const affine = typeof metadata.storage === "string" ? parse("storage", metadata.storage) : {};
  const avatar = new Avatar(id, manifest, entries, data, Object(affine));
  checkMesh(avatar);
  return avatar;
}

/** @param {Uint8Array} data */
function readHeader(data) {
  if (data.length < 8 || data.length > MAX_FILE_BYTES) {
    throw new AvatarError(`it has ${data.length} bytes; an avatar file has 8 to ${MAX_FILE_BYTES}`);
  }
  const length = Number(new DataView(data.buffer, data.byteOffset, 8).getBigUint64(0, true));
  if (length > MAX_HEADER_BYTES || 8 + length > data.length) {
    throw new AvatarError(`its header claims ${length} bytes: this is not an avatar file, or one that was cut`);
  }
  const header = parse("header", new TextDecoder().decode(data.subarray(8, 8 + length)));
  if (typeof header !== "object" || header === null || Array.isArray(header)) {
    throw new AvatarError("its header is no map: this is not an avatar file");
  }
  return { header, start: 8 + length };
}

/** @param {string} field @param {string} text @returns {any} */
function parse(field, text) {
  try {
    return JSON.parse(text);
  } catch {
    throw new AvatarError(`its ${field} is not valid JSON`);
  }
}

/** @param {unknown} value @param {number} low @param {number} high */
function isWithin(value, low, high) {
  return typeof value === "number" && value >= low && value <= high;
}

/** @param {any} manifest @returns {Manifest} */
function checkManifest(manifest) {
  const spec = manifest?.spec;
  if (manifest?.schema_version !== 1) {
    throw new AvatarError(`it is of schema ${String(manifest?.schema_version).slice(0, 20)}; this page reads 1`);
  }
  if (spec?.block !== "G" || spec?.geometry !== "bases" || !Object.hasOwn(ENCODINGS, spec?.encoding)) {
    throw new AvatarError("its model is not one that this page draws (block G with bases); the desktop viewer draws it");
  }
  /** @type {[string, unknown, number, number][]} */
  const numbers = [
    ["uv_encoding_size", spec.uv_encoding_size, 1, 4096],
    ["axis_encoding_size", spec.axis_encoding_size, 1, 16384],
    ["position_scale_m", manifest.position_scale_m, 1e-9, MAX_SCALE_M],
  ];
  for (const [name, count, limit] of /** @type {[string, number, number][]} */ ([
    ["bounds_min_m", 3, MAX_EXTENT_M], ["bounds_max_m", 3, MAX_EXTENT_M], ["view_span", 4, 180],
  ])) {
    const values = Array.isArray(manifest[name]) ? manifest[name] : [];
    numbers.push([name, values.length, count, count]);
    numbers.push(...values.slice(0, count).map((value) => /** @type {[string, unknown, number, number]} */ ([name, value, -limit, limit])));
  }
  for (const [name, value, low, high] of numbers) {
    if (!isWithin(value, low, high) || (name.endsWith("_size") && !Number.isInteger(value))) {
      throw new AvatarError(`manifest.${name} is ${String(value).slice(0, 40)}; ${low} to ${high} is allowed`);
    }
  }
  if (![0, 1, 2].every((axis) => manifest.bounds_min_m[axis] < manifest.bounds_max_m[axis])) {
    throw new AvatarError("manifest.bounds_min_m is not below bounds_max_m");
  }
  const card = manifest.model_card;
  if (typeof card !== "object" || card === null || Array.isArray(card) || Object.keys(card).length > 64) {
    throw new AvatarError("manifest.model_card must be a map of at most 64 entries");
  }
  for (const name of ["name", "identity", "licence"]) {
    const text = manifest[name];
    if (typeof text !== "string" || !/^.{1,200}$/u.test(text) || /(?! )[\p{C}\p{Z}]/u.test(text)) {
      throw new AvatarError(`manifest.${name} must be 1 to 200 printable characters`);
    }
  }
  return manifest;
}

/** Where each tensor lies: within the file, of the size that its shape wants. @param {Record<string, any>} header @param {number} start @param {number} total */
function checkEntries(header, start, total) {
  /** @type {Record<string, Entry>} */
  const entries = Object.create(null);
  for (const [name, entry] of Object.entries(header)) {
    const { dtype, shape, data_offsets: offsets } = Object(entry);
    const isProper = Array.isArray(shape) && shape.length <= 8 && shape.every((side) => Number.isInteger(side) && side > 0);
    const size = isProper && Object.hasOwn(BYTES, dtype) ? shape.reduce((product, side) => product * side, BYTES[dtype]) : NaN;
    const [from, to] = Array.isArray(offsets) ? offsets : [];
    if (!(Number.isInteger(from) && from >= 0 && to - from === size && start + to <= total)) {
      throw new AvatarError(`tensor ${name.slice(0, 80)} has no proper type, shape or place: cut or damaged`);
    }
    entries[name] = { dtype, shape, start: start + from, end: start + to };
  }
  return entries;
}

/** @param {Spec} spec @param {Record<string, Entry>} entries */
function checkShapes(spec, entries) {
  /** @param {string} name @param {number} axis @param {number} limit */
  const side = (name, axis, limit) => {
    const found = entries[name]?.shape[axis] ?? 0;
    if (found < 1 || found > limit) {
      throw new AvatarError(`tensor ${name} has ${found} rows or columns; allowed are 1 to ${limit}`);
    }
    return found;
  };
  const vertices = side("mesh.vertex_uv", 0, MAX_VERTICES);
  const [directions, bases] = [side("linear.mix", 0, MAX_DIRECTIONS), side("linear.mix", 1, MAX_BASES)];
  if (vertices * bases > MAX_COMPONENTS) {
    throw new AvatarError(`${bases} bases of ${vertices} vertices; at most ${MAX_COMPONENTS} products are allowed`);
  }
  const rows = Math.ceil(vertices / MAP_SIZE);
  /** @type {Record<string, number[]>} */
  const wanted = {
    "mesh.vertex_uv": [vertices, 2],
    "mesh.faces": [side("mesh.faces", 0, MAX_FACES), 3],
    "linear.weight": [bases, 256],
    "linear.bias": [bases],
    "linear.mix": [directions, bases],
    "linear.basis": [directions, MAP_SIZE, 3],
    "linear.mean": [rows, MAP_SIZE, 3],
    "linear.rank": [rows],
  };
  DECODER.forEach(([ins, outs], index) => {
    const size = 8 << index;
    wanted[`expression.${index}.first.weight`] = [outs, ins, 3, 3];
    wanted[`expression.${index}.first_bias.weight`] = [outs, size, size];
    wanted[`expression.${index}.expand.weight`] = [4 * outs, outs, 1, 1];
    wanted[`expression.${index}.expand.bias`] = [4 * outs];
  });
  for (const [part] of ENCODINGS[spec.encoding]) {
    const [size, entriesPerAxis] = [spec.uv_encoding_size, spec.axis_encoding_size];
    if (part === "joint") {
      wanted.uv_encoding = [size, size, 4];
    } else if (part === "axes") {
      wanted.u_encoding = wanted.v_encoding = [entriesPerAxis, 2];
    }
  }
  const dense = sineLayers(spec);
  ENCODER.slice(1).forEach((outs, index) => dense.push([`encoder.${index}`, ENCODER[index], outs]));
  for (const [name, ins, outs] of dense) {
    wanted[`${name}.weight`] = [outs, ins];
    wanted[`${name}.bias`] = [outs];
  }
  if ("static.parts" in entries) {
    wanted["static.parts"] = [Math.ceil(vertices / 4)];
  }
  if (Object.keys(entries).some((name) => name.startsWith("level."))) {
    wanted["level.still"] = [8, 8, 4];
    for (const [level, channels] of [[64, 16], [128, 8]]) {
      wanted[`level.${level}.faces`] = [side(`level.${level}.faces`, 0, MAX_FACES), 3];
      wanted[`level.${level}.expression.weight`] = [4, channels, 3, 3];
      wanted[`level.${level}.expression.bias`] = [4, level, level];
    }
    wanted["level.64.expression.local"] = [32, 32, 64];
  }
  const coefficients = side("stream.table_index", 0, 128);
  Object.assign(wanted, {
    "stream.mean": [256], "stream.analysis": [256, coefficients], "stream.synthesis": [coefficients, 256],
    "stream.synthesis_shift": [1], "stream.table_index": [coefficients, 6],
  });
  for (const [name, shape] of Object.entries(wanted)) {
    if (String(entries[name]?.shape) !== String(shape)) {
      throw new AvatarError(`tensor ${name} has shape [${entries[name]?.shape ?? "none"}]; [${shape}] is needed`);
    }
  }
  for (const [name, { dtype }] of Object.entries(entries)) {
    if (!(name in wanted)) {
      throw new AvatarError(`tensor ${name.slice(0, 80)} is unknown`);
    }
    const isIndex = name.endsWith(".faces") || name === "linear.rank";
    const types = isIndex ? ["I32", "U16"] : name === "static.parts" ? ["U8"] : ["F32", "F16", "U8", "U16"];
    if (!name.startsWith("stream.") && !types.includes(dtype)) {
      throw new AvatarError(`tensor ${name} is stored as ${dtype}; allowed are ${types.join(", ")}`);
    }
  }
}

/** What its numbers must keep. @param {Avatar} avatar */
function checkMesh(avatar) {
  const rank = Array.from(avatar.integers("linear.rank"));
  const [directions, bases] = avatar.shape("linear.mix");
  if (rank.some((value) => value < 0 || value > bases) || rank.reduce((a, b) => a + b, 0) !== directions) {
    throw new AvatarError(`tensor linear.rank does not add up to ${directions} directions of at most ${bases} a region`);
  }
  const { bounds_min_m: low, bounds_max_m: high } = avatar.manifest;
  const [x, y, z] = [0, 1, 2].map((axis) => high[axis] - low[axis]);
  for (const level of avatar.levels) {
    if (!avatar.facesOf(level, "decoded").length) {
      throw new AvatarError(`tensor static.parts leaves no triangle of level ${level}; 1 is the least`);
    }
    // Triangles that lie over one another without end would stop every viewer.
    const cover = areaM2(avatar.restM, avatar.faces(level)) / (2 * (x * y + y * z + z * x));
    if (!(cover <= MAX_COVER)) {
      throw new AvatarError(`triangles of level ${level} cover ${cover.toFixed(1)} times the box around the head; the limit is ${MAX_COVER}`);
    }
  }
}

/** @param {Float32Array} places @param {Uint32Array} faces */
function areaM2(places, faces) {
  let sum = 0;
  for (let at = 0; at < faces.length; at += 3) {
    const [a, b, c] = [3 * faces[at], 3 * faces[at + 1], 3 * faces[at + 2]];
    const [px, py, pz] = [places[b] - places[a], places[b + 1] - places[a + 1], places[b + 2] - places[a + 2]];
    const [qx, qy, qz] = [places[c] - places[a], places[c + 1] - places[a + 1], places[c + 2] - places[a + 2]];
    sum += Math.hypot(py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx) / 2;
  }
  return sum;
}

/** @param {string} name @param {Float32Array} values */
function sound(name, values) {
  if (!values.every((value) => Math.abs(value) <= MAX_MAGNITUDE)) {
    throw new AvatarError(`tensor ${name} has values that are not finite or beyond ${MAX_MAGNITUDE}`);
  }
  return values;
}

/** @param {number} bits */
function halfToFloat(bits) {
  const [exponent, fraction, sign] = [(bits >> 10) & 31, bits & 1023, bits & 0x8000 ? -1 : 1];
  if (exponent === 31) {
    return NaN;
  }
  return sign * (exponent ? 2 ** (exponent - 25) * (1024 + fraction) : 2 ** -24 * fraction);
}
