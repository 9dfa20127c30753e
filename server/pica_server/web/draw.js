/**
 * Draws heads: what is visible first, then the pixel decoder on exactly those pixels. Each head
 * that has changed is drawn into a layer of its own; all layers are laid over the room, the
 * farthest first (`render/renderer.py` and `render/passes.py`, whose text the shaders are).
 */

import { MAP_SIZE } from "./avatar.js";
import { openDecoder } from "./decode.js";
import { openBody, openMaps } from "./head.js";
import { clamp, clipFromWorld, lookAt, multiply, NEAR_M } from "./space.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Graphics, Target, Texture } from "./gl.js" */
/** @import { Body } from "./head.js" */
/** @import { Camera, Matrix, Vector } from "./space.js" */
/** @typedef {[number, number, number, number]} Rect Left, bottom, right, top in pixels, rows from
 * the bottom. */
/** @typedef {{camera: Camera, rect: Rect, slots: Set<string>}} View What a camera sees where; of
 * these slots alone. */
/** @typedef {{places: Vector[], speaking: number[]}} Room */
/** @typedef {ReturnType<typeof openMaps>} Maps */
/** @typedef {{avatar: Avatar, body: Body, maps: Maps, version: number}} Slot */
/**
 * @typedef {{slot: string, latent: Float32Array, view: ArrayLike<number>, level: number, isBoth:
 * boolean}} Request */
/**
 * @typedef {object} Placement One head of a frame.
 * @property {string} slot
 * @property {Matrix} matrix Head frame to world.
 * @property {number} fade 0 is as it is, 1 has faded into the room.
 * @property {number} scale Share of the resolution.
 */
/** @typedef {ReturnType<typeof openRenderer>} Renderer */
/** @typedef {ReturnType<typeof openLayer>} Layer */

const [SIDE_STEP_PX, EDGE_PX, MAX_FADE, TABLE_M, MAX_SEATS] = [32, 1, 0.75, 0.31, 16];
const STILL = lookAt([0, 0, 1.1], [0, 0, 0], 0.56, 16, 9);

/** @param {Graphics} graphics @param {boolean} hasRoom Without a room the ground is transparent. */
export function openRenderer(graphics, hasRoom = true) {
  const { gl, compose } = graphics;
  const [mesh, surface] = [compose("mesh.vert"), compose("surface.frag")];
  const programs = {
    surface: graphics.program(compose("mesh.vert", { MAPPED: "" }), surface),
    static: graphics.program(mesh, compose("textured.frag")),
    unwrap: graphics.program(compose("unwrap.vert"), surface),
  };
  const background = graphics.screen("background.frag");
  const enlarge = graphics.screen("enlarge.frag");
  // Over a transparent ground there is nothing to fade into.
  const placeHead = graphics.screen("place_head.frag", hasRoom ? { FADING: "" } : {});
  const smooth = graphics.screen("smooth_edges.frag");
  const decoder = openDecoder(graphics);
  const smallRoom = graphics.texture("RGBA16F", 224, 160, { smooth: true });
  const smallTarget = graphics.target([smallRoom]);
  /** @type {(Target & {image: Texture, drawn: string}) | null} */
  let roomImage = null;
  /** @type {Map<string, Slot>} */
  const slots = new Map();
  /** @type {Map<string, Layer>} */
  let layers = new Map();
  let [versions, composed] = [0, ""];

  /** Put an avatar into a slot. Slots with the same avatar share. @param {string} slot
   * @param {Avatar} avatar */
  function add(slot, avatar) {
    remove(slot);
    decoder.add(avatar);
    const alike = [...slots.values()].find((each) => each.avatar === avatar);
    const body = alike?.body ?? openBody(graphics, programs, avatar, decoder);
    slots.set(slot, { avatar, body, maps: openMaps(graphics, avatar), version: ++versions });
  }

  /** @param {string} slot */
  function remove(slot) {
    const gone = slots.get(slot);
    slots.delete(slot);
    gone?.maps.free();
    if (!gone || [...slots.values()].some(({ avatar }) => avatar === gone.avatar)) return;
    gone.body.free();
    decoder.remove(gone.avatar);
  }

  /** Decode heads; their maps are drawn from now on. @param {Request[]} requests */
  function decode(requests) {
    decoder.decode(requests.flatMap(({ slot, latent, view, level, isBoth }) => {
      const entry = slots.get(slot);
      if (!entry) return [];
      const { positions, codes } = entry.maps.of(level);
      entry.maps.level = level;
      entry.version = ++versions;
      const own = { avatar: entry.avatar, positions: isBoth ? positions : null, codes };
      return [{ ...own, latent, view, level }];
    }));
  }

  /** Seconds that decoding a head at the full level takes here. @param {string} slot */
  function measureDecode(slot) {
    const maps = /** @type {Slot} */ (slots.get(slot)).maps;
    const latent = new Float32Array(256);
    const took = () => {
      const started = performance.now();
      decode([{ slot, latent, view: [0, 0, 1], level: MAP_SIZE, isBoth: true }]);
      gl.bindFramebuffer(gl.FRAMEBUFFER, maps.of(MAP_SIZE).codes.framebuffer);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
      return (performance.now() - started) / 1000;
    };
    took();
    const seconds = took();
    maps.level = 0;
    return seconds;
  }

  /** What is on the screen of a head, and where. @param {Placement} placement @param {View} view */
  function shown(placement, { camera, rect: view }) {
    const entry = slots.get(placement.slot);
    if (!entry?.maps.level) return [];
    const matrix = multiply(clipFromWorld(camera), placement.matrix);
    const rect = screenRect(matrix, entry.body.outline, view);
    if (!rect) return [];
    const { level } = entry.maps;
    const look = JSON.stringify([entry.version, ...matrix, rect, placement.scale]);
    return [{ key: `${view[0]} ${placement.slot}`, entry, placement, matrix, view, rect,
      level, look }];
  }
  /** @typedef {ReturnType<typeof shown>[number]} Shown */

  /** Give each head a layer of its size; what none needs any more is freed.
   * @param {Shown[]} heads */
  function fitLayers(heads) {
    const fitting = heads.map((head) => {
      const { rect, key, placement: { scale } } = head;
      const [width, height] =
        [Math.ceil(scale * (rect[2] - rect[0])), Math.ceil(scale * (rect[3] - rect[1]))];
      const known = layers.get(key);
      const fits = known?.scale === scale && serves(known.width, width)
        && serves(known.height, height);
      const layer = fits ? known : openLayer(graphics, stepped(width), stepped(height), scale);
      return /** @type {[string, Layer]} */ ([key, layer]);
    });
    const kept = new Map(fitting);
    for (const [key, layer] of layers) if (kept.get(key) !== layer) layer.free();
    layers = kept;
  }

  /** Surface, pixels, what has a texture, and the silhouette of one head. @param {Shown} head
   * @param {Layer} layer */
  function drawLayer({ entry: { body, maps }, matrix, view, rect, level, look }, layer) {
    const { position, expression } = maps.of(level);
    const [decoded, textured] = [body.decoded(level), body.textured(level)];
    const common =
      { clip_from_head: cropped(matrix, view, rect, layer), box_m: body.box, shown: body.fadeM };
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    graphics.into(layer.surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    graphics.drawMesh(programs.surface, /** @type {import("./gl.js").Triangles} */ (decoded),
      { ...common, position_map: position });
    graphics.into(layer.coloured);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.disable(gl.CULL_FACE);
    const isChange = level < MAP_SIZE;
    body.colour({ ...layer.coloured, xyz: layer.xyz, uv: layer.uv, expression, isChange,
      shownM: body.fadeM });
    gl.enable(gl.CULL_FACE);
    if (textured && body.skin) {
      graphics.drawMesh(programs.static, textured,
        { ...common, corner: [rect[0], rect[1]], skin: body.skin });
    }
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    graphics.draw(smooth, layer.smoothed, { layer: layer.colour });
    layer.look = look;
  }

  /** Draw the room where it looks different; its image, and whether it did.
   * @param {View[]} views @param {Room} room @param {Target} target */
  function drawRoom(views, room, { width, height }) {
    if (roomImage?.width !== width || roomImage.height !== height) {
      graphics.free(roomImage?.image, roomImage);
      const image = graphics.texture("RGBA8", width, height);
      roomImage = { ...graphics.target([image]), image, drawn: "" };
      graphics.into(roomImage);
      gl.clear(gl.COLOR_BUFFER_BIT);
    }
    const places = room.places.slice(0, MAX_SEATS);
    const seen =
      views.map(({ camera, rect }) => ({ camera: places.length ? camera : STILL, rect }));
    const drawn = JSON.stringify([room, seen]);
    const isNew = drawn !== roomImage.drawn && hasRoom;
    roomImage.drawn = drawn;
    if (!isNew) return { ...roomImage, isNew };
    const seats = new Float32Array(4 * MAX_SEATS);
    places.forEach((place, index) => seats.set([...place, room.speaking[index]], 4 * index));
    const lowest = places.length ? Math.min(...places.map((place) => place[1])) : 0;
    for (const { camera, rect } of seen) {
      graphics.draw(background, smallTarget, {
        seats, num_seats: places.length, table_m: lowest - TABLE_M,
        world_from_view: camera.axes.flat(),
        lens: camera.lens, eye_m: camera.centre,
      });
      graphics.draw(enlarge, roomImage, { image: smallRoom, rect: clipRect(rect, width, height) });
    }
    return { ...roomImage, isNew };
  }

  /** The room, and over it all heads, the farthest first. @param {Shown[]} heads
   * @param {Target & {image: Texture}} room @param {Target} target */
  function layOver(heads, room, target) {
    const { width, height } = target;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, room.framebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target.framebuffer);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    heads.sort((a, b) => b.matrix[15] - a.matrix[15]);
    for (const { key, rect, matrix, view, entry, placement } of heads) {
      const layer = /** @type {Layer} */ (layers.get(key));
      const { scale } = layer;
      graphics.draw(placeHead, target, {
        layer: layer.smooth, room: room.image, rect: clipRect(rect, width, height),
        filled: [(scale * (rect[2] - rect[0])) / layer.width,
          (scale * (rect[3] - rect[1])) / layer.height],
        opacity: 1 - clamp(placement.fade, 0, 1) * MAX_FADE,
        fading: fadingRows(entry.body, matrix, view),
      });
    }
    gl.disable(gl.BLEND);
  }

  /**
   * Draw a frame into the canvas, or into a target, if it looks other than the one before.
   * @param {Placement[]} placements Heads in any order; those without maps are left out.
   * @param {View[]} views @param {Room} room @param {Target} target
   */
  function draw(placements, views, room, target) {
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    const heads = views.flatMap((view) =>
      placements.filter(({ slot }) => view.slots.has(slot))
        .flatMap((placement) => shown(placement, view)));
    fitLayers(heads);
    const changed = heads.filter(({ key, look }) => layers.get(key)?.look !== look);
    for (const head of changed) drawLayer(head, /** @type {Layer} */ (layers.get(head.key)));
    const roomDrawn = drawRoom(views, room, target);
    const { width, height } = target;
    const whole = JSON.stringify(
      [width, height, heads.map(({ key, rect, placement }) => [key, rect, placement.fade])]);
    const isNew = roomDrawn.isNew || changed.length > 0 || whole !== composed;
    composed = whole;
    if (isNew) layOver(heads, roomDrawn, target);
    const triangles = changed.reduce((sum, { entry: { body }, level }) =>
      sum + ((body.decoded(level)?.count ?? 0) + (body.textured(level)?.count ?? 0)) / 3, 0);
    return { isNew, numDrawn: changed.length, triangles };
  }

  return { add, remove, decode, measureDecode, draw };
}

/** Whether a side of a layer has room, and does not leave most empty. @param {number} own
 * @param {number} side */
const serves = (own, side) => (side <= own && own <= side + 2 * SIDE_STEP_PX)
  || own === stepped(side);
/** @param {number} side */
const stepped = (side) => Math.ceil(side / SIDE_STEP_PX) * SIDE_STEP_PX;
/** @param {Rect} rect @param {number} width @param {number} height */
const clipRect = (rect, width, height) =>
  rect.map((side, index) => (2 * side) / (index % 2 ? height : width) - 1);

/** One head as one view sees it; its lower left corner is that of the head's rectangle.
 * @param {Graphics} graphics @param {number} width @param {number} height @param {number} scale Its
 * pixels for each of the picture. */
function openLayer(graphics, width, height, scale) {
  const xyz = graphics.texture(graphics.exact, width, height);
  const uv = graphics.texture(graphics.pairs, width, height);
  const colour = graphics.texture("RGBA8", width, height);
  const smooth = graphics.texture("RGBA8", width, height, { smooth: scale !== 1 });
  const depth = graphics.texture("DEPTH", width, height);
  const targets = {
    surface: graphics.target([xyz, uv], depth), coloured: graphics.target([colour], depth),
    smoothed: graphics.target([smooth]),
  };
  const free = () => graphics.free(...Object.values(targets), xyz, uv, colour, smooth, depth);
  return { width, height, scale, xyz, uv, colour, smooth, ...targets, free, look: "" };
}

/** A row of a matrix times a point. @param {Matrix} matrix @param {number} row
 * @param {number[]} point */
const times = (matrix, row, [x, y, z]) =>
  matrix[4 * row] * x + matrix[4 * row + 1] * y + matrix[4 * row + 2] * z + matrix[4 * row + 3];

/** The whole pixels that a box may cover, within the view; null if nothing is seen.
 * @param {Matrix} matrix @param {number[][]} box @param {Rect} view @returns {Rect | null} */
function screenRect(matrix, box, view) {
  const clip = box.map((point) => [0, 1, 3].map((row) => times(matrix, row, point)));
  if (!clip.flat().every(Number.isFinite) || clip.every(([, , w]) => w <= NEAR_M)) return null;
  if (clip.some(([, , w]) => w <= NEAR_M)) return view;
  const [left, bottom, right, top] = view;
  const [x, y] = [0, 1].map((axis) => clip.map((point) => (point[axis] / point[2] + 1) / 2));
  /** @type {Rect} */
  const rect = [
    Math.max(left + Math.floor(Math.min(...x) * (right - left)) - EDGE_PX, left),
    Math.max(bottom + Math.floor(Math.min(...y) * (top - bottom)) - EDGE_PX, bottom),
    Math.min(left + Math.ceil(Math.max(...x) * (right - left)) + EDGE_PX, right),
    Math.min(bottom + Math.ceil(Math.max(...y) * (top - bottom)) + EDGE_PX, top),
  ];
  return rect[0] < rect[2] && rect[1] < rect[3] ? rect : null;
}

/** Rows of the picture at which nothing is left of the side of a bust that fades first, and from
 * which all is there; then of the other. @param {Body} body @param {Matrix} matrix
 * @param {Rect} view */
function fadingRows({ low, high, fadeM }, matrix, view) {
  const rows = fadeM.map((height) => [low[0], high[0]].flatMap((x) => [low[2], high[2]].map((z) => {
    const [y, w] = [1, 3].map((row) => times(matrix, row, [x, height, z]));
    return view[1] + ((view[3] - view[1]) * (clamp(y / Math.max(w, NEAR_M), -2, 2) + 1)) / 2;
  })));
  return [Math.max(...rows[0]), Math.max(...rows[1]) + 1, Math.min(...rows[0]),
    Math.min(...rows[1]) + 1];
}

/** The matrix to the clip space of a layer, which shows a rectangle of the view.
 * @param {Matrix} matrix @param {Rect} view @param {Rect} rect @param {Layer} layer */
function cropped(matrix, view, rect, { scale, width, height }) {
  const found = Float32Array.from(matrix);
  for (const axis of [0, 1]) {
    const side = view[axis + 2] - view[axis];
    const share = scale / (axis ? height : width);
    const moved = (2 * (view[axis] - rect[axis]) + side) * share - 1;
    for (let column = 0; column < 4; ++column) {
      found[4 * axis + column] = side * share * matrix[4 * axis + column] + moved
        * matrix[12 + column];
    }
  }
  return found;
}
