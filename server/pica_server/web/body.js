/**
 * What the GPU holds of an avatar, its meshes, encodings and weights; and of a head, its maps
 * (`render/gpu_avatar.py`). What does not change with the face gets its texture here, by the
 * avatar's own pixel decoder.
 */

import { filterFaces, MAP_SIZE } from "./avatar.js";
import { UNITS } from "./gl.js";
import { AXIS_ROW, axisLevels, packWeights, sirenSource, specDefines } from "./glsl.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Graphics, Program, Target, Texture } from "./gl.js" */
/** @typedef {{vertices: WebGLVertexArrayObject, count: number, buffers: WebGLBuffer[]}} Triangles */
/** @typedef {{surface: Program, static: Program, unwrap: Program}} MeshPrograms */

const WHOLE_M = [-1e6, -1e6 + 1];
const [BORDER_M, FADE_M, LOWEST_M, CHIN_M] = [0.045, 0.1, -0.31, -0.12];
const [BOUNDS_MARGIN_M, SLACK_M] = [0.01, 0.025];
const [TEXTURE_PX, MARGIN_PX] = [1024, 8];

/** Heights at which nothing is left of a bust whose mesh ends at one, and from which all is there. @param {number} lowerM */
export function fadeHeights(lowerM) {
  const gone = Math.max(lowerM + BORDER_M, LOWEST_M);
  return [gone, Math.max(Math.min(gone + FADE_M, CHIN_M), gone + 0.005)];
}

/** What all heads with one avatar share. */
export class Body {
  /** @param {Graphics} graphics @param {MeshPrograms} programs @param {Avatar} avatar @param {import("./decode.js").Decoder} decoder Has the avatar. */
  constructor(graphics, programs, avatar, decoder) {
    this._graphics = graphics;
    this._programs = programs;
    this.avatar = avatar;
    const { bounds_min_m: low, bounds_max_m: high } = avatar.manifest;
    this.lowM = low.map((value) => value - BOUNDS_MARGIN_M);
    this.highM = high.map((value) => value + BOUNDS_MARGIN_M);
    this.box = Float32Array.from([...this.lowM, ...this.highM]);
    this.fadeM = fadeHeights(avatar.bust().lowerM);
    this.outline = this._outline();
    this.shade = graphics.screen("pixel_decoder.frag", { ...specDefines(avatar.spec), FILTERED: "" }, { "siren.glsl": sirenSource(avatar.spec, graphics.isSoftware ? avatar : null) });
    /** @type {[number, Texture][]} */
    this._textures = this._encodings();
    this._weights = this._uploadWeights();
    /** @type {Map<string, Triangles | null>} */
    this._meshes = new Map();
    this.stillSize = avatar.has("level.still") ? MAP_SIZE : 0;
    this.skin = this.stillSize ? this._bake(this._decodeStill(decoder)) : null;
  }

  /** Make its textures and weights current. */
  bind() {
    this._textures.forEach(([unit, texture]) => this._graphics.bind(unit, texture));
    this._graphics.gl.bindBufferBase(this._graphics.gl.UNIFORM_BUFFER, 0, this._weights);
  }

  /** The decoded triangles of a level. @param {number} level */
  decoded(level) {
    return this._mesh(`decoded ${level}`, () => {
      const { avatar } = this;
      const { faces, used } = renumbered(ordered(this._seen(avatar.facesOf(level, "decoded")), avatar.vertexUv));
      const sheet = avatar.sheetVertices(level);
      const slots = new Map(Array.from(sheet, (vertex, slot) => [vertex, slot]));
      const rows = Math.ceil(sheet.length / level);
      const corners = new Float32Array(4 * used.length);
      used.forEach((vertex, at) => {
        const slot = slots.get(vertex) ?? vertex;
        corners[4 * at] = ((slot % level) + 0.5) / level;
        corners[4 * at + 1] = (Math.floor(slot / level) + 0.5) / rows;
        corners.set(avatar.vertexUv.subarray(2 * vertex, 2 * vertex + 2), 4 * at + 2);
      });
      return this._graphics.triangles(faces, corners, [["vertex_place", 2], ["vertex_uv", 2]]);
    });
  }

  /** The triangles of a level that have a texture, if some have. @param {number} level */
  textured(level) {
    return this._mesh(`static ${level}`, () => {
      const faces = this._seen(this.avatar.facesOf(level, "textured"));
      return faces.length ? this._rest(ordered(faces, this.avatar.vertexUv), [["vertex_xyz_m", 3], ["vertex_uv", 2], ["vertex_opacity", 1]]) : null;
    });
  }

  /** Free all of it. */
  free() {
    const { gl } = this._graphics;
    this._graphics.free(...this._textures.map(([, texture]) => texture), this.skin);
    gl.deleteBuffer(this._weights);
    if (this._graphics.isSoftware) {
      this._graphics.forget(this.shade); // its weights are constants
    }
    this._meshes.forEach((mesh) => {
      gl.deleteVertexArray(mesh?.vertices ?? null);
      mesh?.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    });
  }

  /** @param {string} key @param {() => Triangles | null} make */
  _mesh(key, make) {
    if (!this._meshes.has(key)) {
      this._meshes.set(key, make());
    }
    return this._meshes.get(key) ?? null;
  }

  /** Triangles at rest; each vertex with its place, its UV and how opaque it is. @param {Uint32Array} all @param {[string, number][]} layout */
  _rest(all, layout) {
    const { avatar } = this;
    const { faces, used } = renumbered(all);
    const corners = new Float32Array(6 * used.length);
    used.forEach((vertex, at) => {
      corners.set(avatar.restM.subarray(3 * vertex, 3 * vertex + 3), 6 * at);
      corners.set(avatar.vertexUv.subarray(2 * vertex, 2 * vertex + 2), 6 * at + 3);
      corners[6 * at + 5] = avatar.part(vertex) === 2 ? 1 : 0;
    });
    return this._graphics.triangles(faces, corners, layout);
  }

  /** Triangles that reach up to where something is left of the bust; all, where none does. @param {Uint32Array} faces */
  _seen(faces) {
    const { restM } = this.avatar;
    const seen = filterFaces(faces, (...corners) => Math.max(...corners.map((vertex) => restM[3 * vertex + 1])) > this.fadeM[0]);
    return seen.length ? seen : faces;
  }

  /** Corners of a box that holds all that is drawn: what is still as it is, the rest with slack. */
  _outline() {
    const { avatar } = this;
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (const kind of /** @type {const} */ (["textured", "decoded"])) {
      for (const vertex of this._seen(avatar.facesOf(MAP_SIZE, kind))) {
        const slack = kind === "decoded" ? SLACK_M : 0;
        for (const axis of [0, 1, 2]) {
          low[axis] = Math.min(low[axis], avatar.restM[3 * vertex + axis] - slack);
          high[axis] = Math.max(high[axis], avatar.restM[3 * vertex + axis] + slack);
        }
      }
    }
    low[1] = Math.max(low[1], this.fadeM[0]);
    return corners(low.map((value, axis) => Math.max(value, this.lowM[axis])), high.map((value, axis) => Math.min(value, this.highM[axis])));
  }

  /** @returns {[number, Texture][]} */
  _encodings() {
    const { _graphics: graphics, avatar } = this;
    /** @type {[number, Texture][]} */
    const found = [];
    if (avatar.has("uv_encoding")) {
      const size = avatar.spec.uv_encoding_size;
      const data = avatar.floats("uv_encoding");
      found.push([UNITS.uv_encoding, graphics.texture("RGBA16F", size, size, { data, smooth: true, levels: Math.floor(Math.log2(size)) + 1 })]);
    }
    for (const name of ["u_encoding", "v_encoding"]) {
      if (avatar.has(name)) {
        const data = axisTable(avatar.floats(name), avatar.spec.axis_encoding_size);
        found.push([UNITS[name], graphics.texture("RGBA32F", AXIS_ROW, data.length / 4 / AXIS_ROW, { data })]);
      }
    }
    return found;
  }

  _uploadWeights() {
    const { gl } = this._graphics;
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, buffer);
    gl.bufferData(gl.UNIFORM_BUFFER, packWeights(this.avatar), gl.STATIC_DRAW);
    return buffer;
  }

  /** The expression map of the still face, which levels below the full one add to. @param {import("./decode.js").Decoder} decoder */
  _decodeStill(decoder) {
    const { _graphics: graphics, avatar } = this;
    const still = graphics.texture(graphics.smooth, MAP_SIZE, MAP_SIZE, { smooth: true });
    const codes = graphics.target([still]);
    decoder.decode([{ avatar, latent: avatar.floats("level.still"), view: [0, 0, 1], level: MAP_SIZE, positions: null, codes }]);
    graphics.free(codes);
    this._textures.push([UNITS.still_map, still]);
    return still;
  }

  /** Colour the still face wherever it has a texture. @param {Texture} still */
  _bake(still) {
    const { _graphics: graphics, avatar } = this;
    const { gl } = graphics;
    const faces = avatar.facesOf(MAP_SIZE, "textured");
    if (!faces.length) {
      return null;
    }
    const size = /** @type {const} */ ([TEXTURE_PX, TEXTURE_PX]);
    const [xyz, uv] = [graphics.texture(graphics.exact, ...size), graphics.texture(graphics.pairs, ...size)];
    const depth = graphics.texture("DEPTH", ...size);
    const skin = graphics.texture("RGBA8", ...size, { smooth: true });
    const [surface, coloured] = [graphics.target([xyz, uv], depth), graphics.target([skin], depth)];
    const flat = this._rest(faces, [["vertex_xyz_m", 3], ["vertex_uv", 2], ["vertex_opacity", 1]]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    graphics.use(surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this._programs.unwrap.program);
    gl.uniform1f(this._programs.unwrap.at.margin, MARGIN_PX / TEXTURE_PX);
    gl.bindVertexArray(flat.vertices);
    gl.drawElementsInstanced(gl.TRIANGLES, flat.count, gl.UNSIGNED_INT, 0, 9);
    this.bind();
    graphics.bind(UNITS.expression_map, still);
    graphics.bind(UNITS.visible_xyz, xyz);
    graphics.bind(UNITS.visible_uv, uv);
    graphics.use(coloured);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);
    gl.useProgram(this.shade.program);
    gl.uniform1i(this.shade.at.is_change, 0);
    gl.uniform2f(this.shade.at.shown, WHOLE_M[0], WHOLE_M[1]);
    graphics.drawScreen(this.shade, coloured);
    gl.depthFunc(gl.LESS);
    graphics.free(surface, coloured, xyz, uv, depth);
    gl.deleteVertexArray(flat.vertices);
    flat.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    return skin;
  }
}

/** Decoded maps of one head, by level. */
export class HeadMaps {
  /** @param {Graphics} graphics @param {Avatar} avatar */
  constructor(graphics, avatar) {
    this._graphics = graphics;
    this._avatar = avatar;
    /** Of the maps that came last; 0 before any. */
    this.level = 0;
    /** @type {Map<number, {position: Texture, expression: Texture, positions: Target, codes: Target}>} */
    this._maps = new Map();
  }

  /** Where maps of a level are drawn now, and lie then. @param {number} level */
  of(level) {
    let found = this._maps.get(level);
    if (!found) {
      const { _graphics: graphics } = this;
      const rows = Math.ceil(this._avatar.sheetVertices(level).length / level);
      const position = graphics.texture(graphics.exact, level, rows);
      const expression = graphics.texture(graphics.smooth, level, level, { smooth: true });
      found = { position, expression, positions: graphics.target([position]), codes: graphics.target([expression]) };
      this._maps.set(level, found);
    }
    return found;
  }

  free() {
    this._maps.forEach(({ position, expression, positions, codes }) => this._graphics.free(position, expression, positions, codes));
  }
}

/** A faceless bust of clay for a person whose avatar is not there: heights, half widths, half depths and middles, metres. */
const PROFILE_M = [
  [0.138, 0.001, 0.001, 0], [0.132, 0.031, 0.038, 0], [0.112, 0.057, 0.07, 0], [0.075, 0.075, 0.092, 0],
  [0.03, 0.08, 0.098, 0.002], [-0.02, 0.075, 0.092, 0.006], [-0.06, 0.066, 0.08, 0.012], [-0.09, 0.053, 0.064, 0.012],
  [-0.104, 0.047, 0.054, 0.002], [-0.124, 0.047, 0.05, -0.012], [-0.138, 0.062, 0.058, -0.018], [-0.15, 0.108, 0.074, -0.022],
  [-0.166, 0.146, 0.086, -0.026], [-0.192, 0.167, 0.094, -0.028], [-0.23, 0.174, 0.098, -0.028], [-0.29, 0.174, 0.098, -0.028],
];

/** Stands in for an avatar that is not there or cannot be used; matt, in the room's light. */
export class Placeholder {
  /** @param {Graphics} graphics */
  constructor(graphics) {
    const [profile, columns] = [smoothProfile(), 64];
    const rows = profile.length;
    this.lowM = [-0.174, -0.29, -0.13];
    this.highM = [0.174, 0.138, 0.1];
    this.box = Float32Array.from([...this.lowM, ...this.highM]);
    this.outline = corners(this.lowM, this.highM);
    this.fadeM = fadeHeights(-0.29);
    const data = new Uint8Array(4 * rows * columns).fill(255);
    const places = new Float32Array(6 * rows * columns);
    const faces = [];
    for (let at = 0; at < rows * columns; ++at) {
      const [row, column] = [Math.floor(at / columns), at % columns];
      const [height, wide, deep, middle] = profile[row];
      const turn = ((2 * column) / (columns - 1) - 1) * Math.PI;
      places.set([wide * Math.sin(turn), height, middle + deep * Math.cos(turn), (column + 0.5) / columns, (row + 0.5) / rows, 1], 6 * at);
      const [above, below] = [profile[Math.max(row - 1, 0)], profile[Math.min(row + 1, rows - 1)]];
      const slope = (below[1] - above[1]) / (above[0] - below[0]);
      const normal = [Math.sin(turn), slope, Math.cos(turn)].map((value) => value / Math.hypot(1, slope));
      const light = 0.5 + 0.5 * (0.296 * normal[0] + 0.741 * normal[1] + 0.593 * normal[2]);
      data.set([0.205, 0.225, 0.25].map((dark) => 255 * (dark + light ** 2 * 0.32)), 4 * at);
      if (row + 1 < rows && column + 1 < columns) {
        faces.push(at, at + columns, at + 1, at + 1, at + columns, at + columns + 1);
      }
    }
    this.skin = graphics.texture("RGBA8", columns, rows, { data, smooth: true });
    this._mesh = graphics.triangles(Uint32Array.from(faces), places, [["vertex_xyz_m", 3], ["vertex_uv", 2], ["vertex_opacity", 1]]);
  }

  textured() {
    return this._mesh;
  }
}

/** The profile with its corners rounded. */
function smoothProfile() {
  let rows = PROFILE_M;
  for (let time = 0; time < 2; ++time) {
    // Corners are cut (Chaikin), ends stay.
    const cut = rows.slice(1).flatMap((row, index) => [0.25, 0.75].map((share) => row.map((value, k) => (1 - share) * rows[index][k] + share * value)));
    rows = [rows[0], ...cut, rows[rows.length - 1]];
  }
  return rows;
}

/** Corners of a box, x, y, z of each. @param {number[]} low @param {number[]} high */
function corners(low, high) {
  return Array.from({ length: 8 }, (_, index) => [0, 1, 2].map((axis) => ((index >> axis) & 1 ? high : low)[axis]));
}

/** Neighbours together, along a curve in UV (`sampling.order_faces`). @param {Uint32Array} faces @param {Float32Array} uv */
function ordered(faces, uv) {
  const keys = new Float64Array(faces.length / 3);
  for (let face = 0; face < keys.length; ++face) {
    const cells = [0, 1].map((axis) => {
      const sum = uv[2 * faces[3 * face] + axis] + uv[2 * faces[3 * face + 1] + axis] + uv[2 * faces[3 * face + 2] + axis];
      return Math.min(Math.floor((sum / 3) * 1024), 1023);
    });
    let code = 0;
    for (let bit = 0; bit < 10; ++bit) {
      code |= (((cells[0] >> bit) & 1) << (2 * bit)) | (((cells[1] >> bit) & 1) << (2 * bit + 1));
    }
    keys[face] = code * keys.length + face;
  }
  const found = new Uint32Array(faces.length);
  keys.sort().forEach((key, place) => {
    const face = key % keys.length;
    found.set(faces.subarray(3 * face, 3 * face + 3), 3 * place);
  });
  return found;
}

/** Triangles over the vertices that they use, and which those are. @param {Uint32Array} faces */
function renumbered(faces) {
  const used = Uint32Array.from(new Set(faces)).sort();
  const numbers = new Map(Array.from(used, (vertex, number) => [vertex, number]));
  return { faces: faces.map((vertex) => numbers.get(vertex) ?? 0), used };
}

/** A table of two channels and its levels, each with the way to the next entry, in whole rows (`gpu_avatar.axis_table`). @param {Float32Array} table @param {number} count */
export function axisTable(table, count) {
  const levels = axisLevels(count);
  const total = 2 ** levels;
  const found = new Float32Array(4 * Math.ceil(total / AXIS_ROW) * AXIS_ROW);
  const sums = new Float64Array(2 * (count + 1));
  table.forEach((value, at) => (sums[at + 2] = sums[at] + value));
  for (let level = 0; level < levels; ++level) {
    const [start, step] = [total - (total >> level), 1 << level];
    const entries = Math.ceil(count / step);
    for (let at = 0; at < 2 * entries; ++at) {
      const [entry, channel] = [at >> 1, at & 1];
      const [from, to] = [entry * step, Math.min((entry + 1) * step, count)];
      const mean = (sums[2 * to + channel] - sums[2 * from + channel]) / (to - from);
      const place = 4 * (start + entry) + channel;
      found[place] = mean;
      if (entry) {
        found[place - 2] = mean - found[place - 4];
      }
    }
  }
  return found;
}
