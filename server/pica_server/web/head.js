/**
 * What the GPU holds of an avatar, its meshes, encodings and weights; and of a head, its maps
 * (`render/gpu_avatar.py`). What does not change with the face gets its texture here, by the
 * avatar's own pixel decoder.
 */

import { filterFaces, MAP_SIZE, verticesOf } from "./avatar.js";
import { AXIS_ROW, axisLevels, pixelDefines, sirenSource } from "./siren.js";

const WHOLE_M = [-1e6, -1e6 + 1];
const [BORDER_M, FADE_M, LOWEST_M, CHIN_M] = [0.045, 0.1, -0.31, -0.12];
const [BOUNDS_MARGIN_M, SLACK_M] = [0.01, 0.025];
/** The texture of what is still: at first a coarse one, for the first picture comes sooner. */
const [COARSE_PX, TEXTURE_PX, MARGIN] = [256, 1024, 1 / 128];
/** @type {[string, number][]} */
const REST = [["vertex_xyz_m", 3], ["vertex_uv", 2], ["vertex_opacity", 1]];

/** What all heads with one avatar share. @param {Graphics} graphics
 * @param {MeshPrograms} programs @param {Avatar} avatar @param {Decoder} decoder Has the avatar. */
export function openBody(graphics, programs, avatar, decoder) {
  const { gl } = graphics;
  const { vertexUv, restM, manifest } = avatar;
  const low = manifest.bounds_min_m.map((value) => value - BOUNDS_MARGIN_M);
  const high = manifest.bounds_max_m.map((value) => value + BOUNDS_MARGIN_M);
  const goneM = Math.max(avatar.bust().lowerM + BORDER_M, LOWEST_M);
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
    const size = layout.reduce((sum, [, each]) => sum + each, 0);
    const corners = new Float32Array(size * used.length);
    used.forEach((vertex, place) => {
      places[vertex] = place;
      corners.set(numbers(vertex), size * place);
    });
    return graphics.triangles(faces.map((vertex) => places[vertex]), corners, layout);
  }

  /** Triangles at rest. @param {Uint32Array} faces */
  const atRest = (faces) => triangles(faces, REST, (vertex) => [
    ...restM.subarray(3 * vertex, 3 * vertex + 3), vertexUv[2 * vertex], vertexUv[2 * vertex + 1],
    avatar.part(vertex) === 2 ? 1 : 0,
  ]);

  /** Triangles that are decoded. @param {number} level @param {Uint32Array} faces */
  function moving(level, faces) {
    const sheet = avatar.sheetVertices(level);
    const slots = new Uint32Array(avatar.numVertices);
    sheet.forEach((vertex, slot) => (slots[vertex] = slot));
    const rows = Math.ceil(sheet.length / level);
    return triangles(faces, [["vertex_place", 2], ["vertex_uv", 2]], (vertex) => [
      ((slots[vertex] % level) + 0.5) / level, (Math.floor(slots[vertex] / level) + 0.5) / rows,
      vertexUv[2 * vertex], vertexUv[2 * vertex + 1],
    ]);
  }

  /** The triangles of a level that are decoded, or those that have a texture, if some have.
   * @type {(level: number, kind: "decoded" | "textured") => Triangles | null} */
  function mesh(level, kind) {
    const key = `${level} ${kind}`;
    const faces = meshes.has(key) ? null : seen(level, kind);
    if (faces) meshes.set(key, kind === "decoded" ? moving(level, faces) : atRest(faces));
    return meshes.get(key) ?? null;
  }

  /** Corners of a box that holds all that is drawn: what is still as it is, the rest with slack. */
  function outline() {
    const kinds = [seen(MAP_SIZE, "textured"), seen(MAP_SIZE, "decoded")];
    const sides = [0, 1, 2].map((axis) => {
      let [least, most] = [Infinity, -Infinity];
      kinds.forEach((faces, isDecoded) => faces.forEach((vertex) => {
        const place = restM[3 * vertex + axis];
        least = Math.min(least, place - isDecoded * SLACK_M);
        most = Math.max(most, place + isDecoded * SLACK_M);
      }));
      const floor = axis === 1 ? Math.max(low[axis], goneM) : low[axis];
      return [Math.max(least, floor), Math.min(most, high[axis])];
    });
    return Array.from({ length: 8 }, (_, index) =>
      sides.map((side, axis) => side[(index >> axis) & 1]));
  }

  /** Colour the still face wherever it has a texture. @param {number} side Pixels. */
  function bake(side) {
    const faces = avatar.facesOf(MAP_SIZE, "textured");
    if (!faces.length) return null;
    const [xyz, uv, depth, skin] = [graphics.exact, graphics.pairs, /** @type {Format} */ ("DEPTH"),
        /** @type {Format} */ ("RGBA8")].map((format) =>
        graphics.texture(format, side, side, { smooth: format === "RGBA8" }));
    const [surface, coloured] = [graphics.target([xyz, uv], depth), graphics.target([skin], depth)];
    const flat = atRest(faces);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    graphics.into(surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    graphics.drawMesh(programs.unwrap, flat, { margin: MARGIN, box_m: box }, 9);
    graphics.into(coloured);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    colour(coloured, { visible_xyz: xyz, visible_uv: uv, expression_map: still, is_change: false,
      shown: WHOLE_M });
    graphics.free(surface, coloured, xyz, uv, depth, flat);
    return skin;
  }

  /** Run the pixel decoder where a surface is before the far plane.
   * @param {Target} target @param {Record<string, any>} surface */
  function colour(target, surface) {
    gl.depthFunc(gl.GREATER);
    gl.depthMask(false);
    graphics.draw(shade, target, { ...encodings, still_map: still, ...surface });
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
  }

  const box = Float32Array.from([...low, ...high]);
  const codes = graphics.target([still]);
  decoder.decode([{ avatar, latent: avatar.floats("level.still", 256), view: [0, 0, 1],
    level: MAP_SIZE, positions: null, codes }]);
  graphics.free(codes);
  return {
    skin: bake(COARSE_PX),
    isDrawn: false,
    isSharp: false,
    /** Give it the whole texture, after it was drawn once. */
    sharpen() {
      graphics.free(this.skin);
      this.skin = bake(TEXTURE_PX);
      this.isSharp = true;
    },
    box, mesh, colour, outline: outline(),
    /** Heights at which nothing is left of the bust, and from which all is there. */
    fadeM: [goneM, Math.max(Math.min(goneM + FADE_M, CHIN_M), goneM + 0.005)],
    free() {
      graphics.free(...Object.values(encodings), still, this.skin, ...meshes.values());
      graphics.forget(shade); // its weights are constants
    },
  };
}

/** @type {(graphics: Graphics, avatar: Avatar) => Record<string, Texture>} */
function openEncodings(graphics, avatar) {
  const [[size], [count]] = [avatar.shape("uv_encoding"), avatar.shape("u_encoding")];
  const joint = graphics.texture("RGBA16F", size, size,
    { smooth: true, levels: Math.floor(Math.log2(size)) + 1 });
  graphics.write(joint, avatar.floats("uv_encoding", 4 * size * size));
  graphics.gl.generateMipmap(graphics.gl.TEXTURE_2D);
  const [u, v] = ["u_encoding", "v_encoding"].map((name) => {
    const data = axisTable(avatar.floats(name, 2 * count), count);
    return graphics.write(
      graphics.texture("RGBA32F", AXIS_ROW, data.length / 4 / AXIS_ROW), data);
  });
  return { uv_encoding: joint, u_encoding: u, v_encoding: v };
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
    const [positions, codes] = [graphics.target([position]), graphics.target([expression])];
    return { position, expression, positions, codes };
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
function axisTable(table, count) {
  const levels = axisLevels(count);
  const total = 2 ** levels;
  const found = new Float32Array(4 * Math.ceil(total / AXIS_ROW) * AXIS_ROW);
  const sums = new Float64Array(2 * (count + 1));
  table.forEach((value, at) => (sums[at + 2] = sums[at] + value));
  for (let level = 0; level < levels; ++level) {
    const [start, step] = [total - (total >> level), 1 << level];
    for (let at = 0; at < 2 * Math.ceil(count / step); ++at) {
      const [entry, channel] = [at >> 1, at & 1];
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
