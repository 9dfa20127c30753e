/**
 * Avatar files (`.pica`): safetensors with a manifest, read without trust: what is asked for is
 * there and of its size, or one line says what is wrong. This page draws what `pica export` makes
 * of the usual model: block G with bases, levels and the full encoding. Not checked: how far bases
 * may move triangles over one another; shaders keep all within the box, and a lost context heals.
 */

export const MAP_SIZE = 256;
/** Map sizes that an avatar can be decoded to. */
export const LEVELS = [64, 128, MAP_SIZE];
/** Inputs and outputs of each block of the expression decoder. */
export const DECODER = [[7, 32], [32, 16], [16, 16], [16, 8], [8, 4]];
/** Name, inputs and outputs of each sine layer: of the xyz code, then of the pixel decoder.
 * @type {[string, number, number][]} */
export const SINE_LAYERS = [
  ["xyz.0", 3, 4], ["xyz.1", 4, 4],
  ["pixel.0", 16, 8], ["pixel.1", 8, 8], ["pixel.2", 8, 8], ["pixel.3", 8, 3],
];
export const MAX_FILE_BYTES = 64 * 2 ** 20;
const MAX_HEADER_BYTES = 256 * 2 ** 10;
const [MAX_SIDE, MAX_VERTICES, MAX_COMPONENTS, MAX_COVER] = [16_384, 200_000, 4e6, 4];
const [MAX_EXTENT_M, MAX_SCALE_M, MAX_SCALE] = [0.45, 10, 1e6];
const [SEAM, STATIC] = [1, 2];
/** @type {Record<string, any>} */
const ARRAYS = {
  F32: Float32Array, F16: Float16Array, I32: Int32Array, I16: Int16Array, U16: Uint16Array,
  U8: Uint8Array,
};

/** What is wrong with an avatar, in one line. */
export class AvatarError extends Error {}

/** @type {(holds: unknown, problem: string) => void} */
function demand(holds, problem) {
  if (!holds) throw new AvatarError(problem);
}

/** Whether a value is so many numbers within a limit.
 * @type {(value: any, count: number, limit: number) => boolean} */
const areNumbers = (value, count, limit) => Array.isArray(value) && value.length === count
  && value.every((each) => typeof each === "number" && Math.abs(each) <= limit);

/** A checked avatar. */
export class Avatar {
  /** @param {ArrayBuffer} bytes @param {Manifest} manifest
   * @param {Record<string, Entry>} entries @param {Record<string, Affine>} affine */
  constructor(bytes, manifest, entries, affine) {
    this.manifest = manifest;
    this._bytes = bytes;
    this._entries = entries;
    this._affine = affine;
    this.vertexUv = this.floats("mesh.vertex_uv").map((value) => Math.min(Math.max(value, 0), 1));
    this.numVertices = this.vertexUv.length / 2;
    const rows = Math.ceil(this.numVertices / MAP_SIZE);
    /** Where vertices are at rest, metres. */
    this.restM = this.floats("linear.mean", rows * MAP_SIZE * 3);
    /** Directions of the bases for the vertices of each row. */
    this.rank = this.integers("linear.rank", rows);
    this._parts = "static.parts" in entries
      ? this.integers("static.parts", Math.ceil(this.numVertices / 4)) : [];
    this._faces = LEVELS.map((level) =>
      new Uint32Array(this.integers(level === MAP_SIZE ? "mesh.faces" : `level.${level}.faces`)));
    this._check();
  }

  /** @param {string} name */
  shape(name) {
    demand(name in this._entries, `tensor ${name} is missing`);
    return this._entries[name].shape;
  }

  /** A tensor as its file holds it; with a size, it has so many numbers.
   * @param {string} name @returns {any} */
  integers(name, size = 0) {
    const shape = this.shape(name);
    const { dtype, start, end } = this._entries[name];
    const found = new ARRAYS[dtype](this._bytes.slice(start, end));
    demand(!size || found.length === size,
      `tensor ${name} has shape [${shape}]; ${size} numbers are needed`);
    return found;
  }

  /** A tensor as floats. @param {string} name */
  floats(name, size = 0) {
    const affine = this._affine[name];
    const found = new Float32Array(this.integers(name, size));
    affine?.scale.forEach((scale, channel, { length }) => {
      for (let at = channel; at < found.length; at += length) {
        found[at] = affine.offset[channel] + Math.fround(scale) * found[at];
      }
    });
    return found;
  }

  /** Triangles of a level. @param {number} level */
  faces(level) {
    return this._faces[LEVELS.indexOf(level)];
  }

  /** Those that are decoded, or those that have a texture.
   * @param {number} level @param {"decoded" | "textured"} kind */
  facesOf(level, kind) {
    return filterFaces(this.faces(level), (a, b, c) => {
      const least = Math.min(this.part(a), this.part(b), this.part(c));
      return kind === "textured" ? least >= SEAM : least < STATIC;
    });
  }

  /** What a vertex belongs to: 0 moves, 1 is the seam, 2 has a texture. @param {number} vertex */
  part(vertex) {
    return Math.min(((this._parts[vertex >> 2] ?? 0) >> (2 * (vertex & 3))) & 3, STATIC);
  }

  /** The vertices that a decode at a level makes, in the order of its sheet.
   * @param {number} level */
  sheetVertices(level) {
    return level === MAP_SIZE ? Uint32Array.from({ length: this.numVertices }, (_, index) => index)
      : verticesOf(this.faces(level));
  }

  /** Width of the shoulders, and the height at which the mesh ends, metres. */
  bust() {
    let [widthM, lowerM] = [0, Infinity];
    for (const vertex of this.faces(MAP_SIZE)) {
      widthM = Math.max(widthM, 2 * Math.abs(this.restM[3 * vertex]));
      lowerM = Math.min(lowerM, this.restM[3 * vertex + 1]);
    }
    return { widthM, lowerM };
  }

  _check() {
    const [directions, bases] = this.shape("linear.mix");
    /** @type {number[]} */
    const rank = Array.from(this.rank);
    const isRank = rank.every((value) => value >= 0 && value <= bases)
      && rank.reduce((a, b) => a + b) === directions;
    demand(isRank && this.numVertices <= MAX_VERTICES && this.numVertices * bases <= MAX_COMPONENTS,
      `linear.rank does not add up to ${directions} directions of at most ${bases} a region`);
    const { bounds_min_m: low, bounds_max_m: high } = this.manifest;
    const [x, y, z] = [0, 1, 2].map((axis) => high[axis] - low[axis]);
    for (const level of LEVELS) {
      const faces = this.faces(level);
      demand(faces.every((vertex) => vertex < this.numVertices),
        `level ${level} names vertices that are not there`);
      demand(this.facesOf(level, "decoded").length,
        `tensor static.parts leaves no triangle of level ${level}`);
      // Triangles that lie over one another without end would stop every viewer.
      const cover = areaM2(this.restM, faces) / (2 * (x * y + y * z + z * x));
      demand(cover <= MAX_COVER,
        `triangles of level ${level} cover ${cover.toFixed(1)} times the box around the head`);
    }
  }
}

/** The vertices that triangles have, ascending. @param {Uint32Array} faces */
export function verticesOf(faces) {
  const isUsed = new Uint8Array(MAX_VERTICES);
  faces.forEach((vertex) => (isUsed[vertex] = 1));
  return Uint32Array.from(isUsed.keys()).filter((vertex) => isUsed[vertex]);
}

/** The triangles that pass. @param {Uint32Array} faces
 * @param {(a: number, b: number, c: number) => boolean} passes */
export function filterFaces(faces, passes) {
  const found = [];
  for (let at = 0; at < faces.length; at += 3) {
    const [a, b, c] = [faces[at], faces[at + 1], faces[at + 2]];
    if (passes(a, b, c)) found.push(a, b, c);
  }
  return Uint32Array.from(found);
}

/**
 * Read and check an avatar.
 * @param {ArrayBuffer} bytes
 * @throws {AvatarError} What is wrong with it.
 */
export function openAvatar(bytes) {
  const total = bytes.byteLength;
  demand(total >= 8 && total <= MAX_FILE_BYTES, `it has ${total} bytes: this is no avatar file`);
  const start = 8 + Number(new DataView(bytes).getBigUint64(0, true));
  demand(start <= Math.min(8 + MAX_HEADER_BYTES, total),
    "this is no avatar file, or one that was cut");
  const text = new TextDecoder().decode(new Uint8Array(bytes, 8, start - 8));
  const { __metadata__: metadata, ...header } = parse("header", text);
  const manifest = parse("manifest", metadata?.pica);
  const affine = parse("storage", metadata?.storage ?? "{}");
  checkManifest(manifest);
  const entries = Object.entries(header)
    .map(([name, entry]) => [name, checkEntry(name, Object(entry), affine, start, total)]);
  return new Avatar(bytes, manifest, Object.fromEntries(entries), affine);
}

/** @type {(field: string, text: string) => any} */
function parse(field, text) {
  try {
    return Object(JSON.parse(text));
  } catch {
    throw new AvatarError(`its ${field} is no JSON: this is no avatar file`);
  }
}

/** @param {any} manifest */
function checkManifest({ schema_version: version, spec, position_scale_m: scale, view_span: span,
  bounds_min_m: low, bounds_max_m: high }) {
  demand(version === 1, `it is of schema ${String(version).slice(0, 20)}; this page reads 1`);
  demand(spec?.block === "G" && spec.geometry === "bases" && spec.encoding === "full",
    "its model is not one that this page draws (block G with bases); the desktop viewer draws it");
  const isBox = areNumbers(low, 3, MAX_EXTENT_M) && areNumbers(high, 3, MAX_EXTENT_M)
    && [0, 1, 2].every((axis) => low[axis] < high[axis]);
  demand(isBox && areNumbers(span, 4, 180) && areNumbers([scale], 1, MAX_SCALE_M) && scale > 0,
    "its manifest has no sound bounds, view_span or position_scale_m");
}

/** @type {(name: string, entry: any, affine: any, start: number, total: number) => Entry} */
function checkEntry(name, { dtype, shape, data_offsets: offsets }, affine, start, total) {
  const isShape = Array.isArray(shape) && shape.length > 0
    && shape.every((side) => Number.isInteger(side) && side > 0
      && (side <= MAX_SIDE || side === shape[0]));
  const channels = isShape ? shape[shape.length - 1] : 0;
  const { scale, offset } = Object(affine[name]);
  // What counts is stored as it is; other whole numbers are codes.
  const isCount = /faces$|rank$|parts$/.test(name);
  const isCode = areNumbers(scale, channels, MAX_SCALE) && areNumbers(offset, channels, MAX_SCALE);
  const isType = Object.hasOwn(ARRAYS, dtype) && isCode === !(isCount || dtype.startsWith("F"))
    && !(isCount && dtype.startsWith("F"));
  const bytes = isShape && isType
    ? shape.reduce((product, side) => product * side, ARRAYS[dtype].BYTES_PER_ELEMENT) : NaN;
  const [from, to] = Array.isArray(offsets) ? offsets : [];
  demand(Number.isInteger(from) && from >= 0 && to - from === bytes && start + to <= total,
    `tensor ${name.slice(0, 80)} is cut or damaged: it has no proper type, shape or place`);
  return { dtype, shape, start: start + from, end: start + to };
}

/** @param {Float32Array} places @param {Uint32Array} faces */
function areaM2(places, faces) {
  let sum = 0;
  for (let at = 0; at < faces.length; at += 3) {
    const [a, b, c] = [3 * faces[at], 3 * faces[at + 1], 3 * faces[at + 2]];
    /** @type {(axis: number, other: number) => number} */
    const cross = (axis, other) => (places[b + axis] - places[a + axis])
      * (places[c + other] - places[a + other])
      - (places[b + other] - places[a + other]) * (places[c + axis] - places[a + axis]);
    sum += Math.hypot(cross(1, 2), cross(2, 0), cross(0, 1)) / 2;
  }
  return sum;
}
