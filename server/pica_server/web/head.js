/**
 * What the GPU holds of an avatar, its meshes, encodings and weights; and of a head, its maps
 * (`render/gpu_avatar.py`). What does not change with the face gets its texture here, by the
 * avatar's own pixel decoder.
 */

import { filterFaces, MAP_SIZE, verticesOf } from "./avatar.js";
import { AXIS_ROW, axisLevels, pixelDefines, sirenSource } from "./siren.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Decoder } from "./decode.js" */
/** @import { Graphics, Program, Texture, Triangles } from "./gl.js" */
/** @typedef {ReturnType<typeof openBody>} Body */
/** @typedef {{surface: Program, static: Program, unwrap: Program}} MeshPrograms */

const WHOLE_M = [-1e6, -1e6 + 1];
const [BORDER_M, FADE_M, LOWEST_M, CHIN_M] = [0.045, 0.1, -0.31, -0.12];
const [BOUNDS_MARGIN_M, SLACK_M] = [0.01, 0.025];
const [TEXTURE_PX, MARGIN_PX] = [1024, 8];
/** @type {[string, number][]} */
const REST = [["vertex_xyz_m", 3], ["vertex_uv", 2], ["vertex_opacity", 1]];

/** What all heads with one avatar share. @param {Graphics} graphics
 * @param {MeshPrograms} programs @param {Avatar} avatar @param {Decoder} decoder Has the avatar. */
export function openBody(graphics, programs, avatar, decoder) {
  const { gl } = graphics;
  const { vertexUv, restM, manifest } = avatar;
  const low = manifest.bounds_min_m.map((value) => value - BOUNDS_MARGIN_M);
  const high = manifest.bounds_max_m.map((value) => value + BOUNDS_MARGIN_M);
  const box = Float32Array.from([...low, ...high]);
  const goneM = Math.max(avatar.bust().lowerM + BORDER_M, LOWEST_M);
  /** Heights at which nothing is left of the bust, and from which all is there. */
  const fadeM = [goneM, Math.max(Math.min(goneM + FADE_M, CHIN_M), goneM + 0.005)];
  const shade = graphics.screen("pixel_decoder.frag", pixelDefines(avatar), sirenSource(avatar));
  const encodings = openEncodings(graphics, avatar);
  const still = graphics.texture(graphics.smooth, MAP_SIZE, MAP_SIZE, { smooth: true });
  /** @type {Map<string, Triangles | null>} */
  const meshes = new Map();

  /** Triangles that reach up to where something is left of the bust; all, where none does.
   * @param {number} level @param {"decoded" | "textured"} kind */
  function seen(level, kind) {
    const faces = avatar.facesOf(level, kind);
    /** @param {number} vertex */
    const isSeen = (vertex) => restM[3 * vertex + 1] > goneM;
    const found = filterFaces(faces, (a, b, c) => isSeen(a) || isSeen(b) || isSeen(c));
    return found.length ? found : faces;
  }

  /** Triangles over the vertices that they use, each with so many numbers.
   * @param {Uint32Array} faces @param {[string, number][]} layout
   * @param {(vertex: number) => number[]} numbers */
  function triangles(faces, layout, numbers) {
    const places = new Uint32Array(avatar.numVertices);
    const used = verticesOf(faces);
    used.forEach((vertex, place) => (places[vertex] = place));
    const size = layout.reduce((sum, [, each]) => sum + each, 0);
    const corners = new Float32Array(size * used.length);
    used.forEach((vertex, place) => corners.set(numbers(vertex), size * place));
    return graphics.triangles(faces.map((vertex) => places[vertex]), corners, layout);
  }

  /** Triangles at rest. @param {Uint32Array} faces */
  const atRest = (faces) => triangles(faces, REST, (vertex) => [
    ...restM.subarray(3 * vertex, 3 * vertex + 3), vertexUv[2 * vertex], vertexUv[2 * vertex + 1],
    avatar.part(vertex) === 2 ? 1 : 0,
  ]);

  /** @param {string} key @param {() => Triangles | null} make */
  function mesh(key, make) {
    if (!meshes.has(key)) meshes.set(key, make());
    return meshes.get(key) ?? null;
  }

  /** The decoded triangles of a level. @param {number} level */
  const decoded = (level) => mesh(`decoded ${level}`, () => {
    const sheet = avatar.sheetVertices(level);
    const slots = new Uint32Array(avatar.numVertices);
    sheet.forEach((vertex, slot) => (slots[vertex] = slot));
    const rows = Math.ceil(sheet.length / level);
    return triangles(seen(level, "decoded"), [["vertex_place", 2], ["vertex_uv", 2]], (vertex) => {
      const [row, column] = [Math.floor(slots[vertex] / level), slots[vertex] % level];
      return [(column + 0.5) / level, (row + 0.5) / rows, vertexUv[2 * vertex],
        vertexUv[2 * vertex + 1]];
    });
  });

  /** The triangles of a level that have a texture, if some have. @param {number} level */
  const textured = (level) => mesh(`static ${level}`, () => {
    const faces = seen(level, "textured");
    return faces.length ? atRest(faces) : null;
  });

  /** Corners of a box that holds all that is drawn: what is still as it is, the rest with slack. */
  function outline() {
    const [least, most] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (const kind of /** @type {const} */ (["textured", "decoded"])) {
      const slack = kind === "decoded" ? SLACK_M : 0;
      for (const vertex of seen(MAP_SIZE, kind)) {
        for (const axis of [0, 1, 2]) {
          least[axis] =
            Math.max(Math.min(least[axis], restM[3 * vertex + axis] - slack), low[axis]);
          most[axis] = Math.min(Math.max(most[axis], restM[3 * vertex + axis] + slack), high[axis]);
        }
      }
    }
    least[1] = Math.max(least[1], goneM);
    return Array.from({ length: 8 },
      (_, index) => [0, 1, 2].map((axis) => ((index >> axis) & 1 ? most : least)[axis]));
  }

  /** Colour the still face wherever it has a texture. */
  function bake() {
    const codes = graphics.target([still]);
    decoder.decode([{ avatar, latent: avatar.floats("level.still", 256), view: [0, 0, 1],
      level: MAP_SIZE, positions: null, codes }]);
    graphics.free(codes);
    const faces = avatar.facesOf(MAP_SIZE, "textured");
    if (!faces.length) return null;
    /** @type {[number, number]} */
    const size = [TEXTURE_PX, TEXTURE_PX];
    const [xyz, uv] =
      [graphics.texture(graphics.exact, ...size), graphics.texture(graphics.pairs, ...size)];
    const depth = graphics.texture("DEPTH", ...size);
    const skin = graphics.texture("RGBA8", ...size, { smooth: true });
    const [surface, coloured] = [graphics.target([xyz, uv], depth), graphics.target([skin], depth)];
    const flat = atRest(faces);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    graphics.into(surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    graphics.drawMesh(programs.unwrap, flat, { margin: MARGIN_PX / TEXTURE_PX, box_m: box }, 9);
    graphics.into(coloured);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    colour({ ...coloured, xyz, uv, expression: still, isChange: false, shownM: WHOLE_M });
    graphics.free(surface, coloured, xyz, uv, depth, flat);
    return skin;
  }

  /**
   * Run the pixel decoder where a surface is before the far plane.
   * @param {import("./gl.js").Target & {xyz: Texture, uv: Texture, expression: Texture, isChange:
   * boolean, shownM: number[]}} surface
   */
  function colour({ xyz, uv, expression, isChange, shownM, ...target }) {
    gl.depthFunc(gl.GREATER);
    gl.depthMask(false);
    graphics.draw(shade, target, {
      ...encodings, visible_xyz: xyz, visible_uv: uv, expression_map: expression, still_map: still,
      is_change: isChange, shown: shownM,
    });
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
  }

  const skin = bake();
  return {
    avatar, box, low, high, fadeM, outline: outline(), skin, decoded, textured, colour,
    free() {
      graphics.free(...Object.values(encodings), still, skin, ...meshes.values());
      graphics.forget(shade); // its weights are constants
    },
  };
}

/** @param {Graphics} graphics @param {Avatar} avatar @returns {Record<string, Texture>} */
function openEncodings(graphics, avatar) {
  const { gl } = graphics;
  const [size] = avatar.shape("uv_encoding");
  const joint = graphics.texture("RGBA16F", size, size,
    { smooth: true, levels: Math.floor(Math.log2(size)) + 1 });
  graphics.write(joint, avatar.floats("uv_encoding", 4 * size * size));
  gl.generateMipmap(gl.TEXTURE_2D);
  const axes = ["u_encoding", "v_encoding"].map((name) => {
    const [count] = avatar.shape("u_encoding");
    const data = axisTable(avatar.floats(name, 2 * count), count);
    return [name,
      graphics.write(graphics.texture("RGBA32F", AXIS_ROW, data.length / 4 / AXIS_ROW), data)];
  });
  return { uv_encoding: joint, ...Object.fromEntries(axes) };
}

/** Decoded maps of one head, by level. @param {Graphics} graphics @param {Avatar} avatar */
export function openMaps(graphics, avatar) {
  /** @type {Map<number, ReturnType<typeof make>>} */
  const maps = new Map();
  /** @param {number} level */
  function make(level) {
    const rows = Math.ceil(avatar.sheetVertices(level).length / level);
    const position = graphics.texture(graphics.exact, level, rows);
    const expression = graphics.texture(graphics.smooth, level, level, { smooth: true });
    return { position, expression, positions: graphics.target([position]),
      codes: graphics.target([expression]) };
  }
  return {
    /** Of the maps that came last; 0 before any. */
    level: 0,
    /** Where maps of a level are drawn, and lie then. @param {number} level */
    of(level) {
      const found = maps.get(level) ?? make(level);
      maps.set(level, found);
      return found;
    },
    free() {
      for (const each of maps.values()) graphics.free(...Object.values(each));
    },
  };
}

/** A table of two channels and its levels, each with the way to the next entry, in whole rows
 * (`gpu_avatar.axis_table`). @param {Float32Array} table @param {number} count */
export function axisTable(table, count) {
  const levels = axisLevels(count);
  const total = 2 ** levels;
  const found = new Float32Array(4 * Math.ceil(total / AXIS_ROW) * AXIS_ROW);
  const sums = new Float64Array(2 * (count + 1));
  table.forEach((value, at) => (sums[at + 2] = sums[at] + value));
  for (let level = 0; level < levels; ++level) {
    const [start, step] = [total - (total >> level), 1 << level];
    for (let at = 0; at < 2 * Math.ceil(count / step); ++at) {
      const entry = at >> 1;
      const channel = at & 1;
      const from = entry * step;
      const to = Math.min(from + step, count);
      const mean = (sums[2 * to + channel] - sums[2 * from + channel]) / (to - from);
      const place = 4 * (start + entry) + channel;
      found[place] = mean;
      if (entry) found[place - 2] = mean - found[place - 4];
    }
  }
  return found;
}
