/**
 * Draws heads: what is visible first, then the pixel decoder on exactly those pixels. Each head
 * that has changed is drawn into a layer of its own; all layers are laid over the room, the
 * farthest first (`render/renderer.py` and `render/passes.py`, whose text the shaders are).
 */

import { MAP_SIZE } from "./avatar.js";
import { openDecoder } from "./decode.js";
import { openBody, openMaps } from "./head.js";
import { clamp, clipFromWorld, lookAt, multiply, NEAR_M } from "./space.js";

const [SIDE_STEP_PX, EDGE_PX, MAX_FADE, TABLE_M, MAX_SEATS] = [32, 1, 0.75, 0.31, 16];
const STILL = lookAt([0, 0, 1.1], [0, 0, 0], 0.56, 16, 9);

/** @param {Graphics} graphics @param {boolean} hasRoom Without a room the ground is transparent. */
export function openRenderer(graphics, hasRoom = true) {
  const { gl } = graphics;
  const programs = {
    surface: graphics.program("mesh.vert", "surface.frag", { MAPPED: "" }),
    static: graphics.program("mesh.vert", "textured.frag"),
    unwrap: graphics.program("unwrap.vert", "surface.frag"),
  };
  const background = graphics.screen("background.frag");
  const enlarge = graphics.screen("enlarge.frag");
  // Over a transparent ground there is nothing to fade into.
  const finish = graphics.screen("finish_head.frag", hasRoom ? { FADING: "" } : {});
  const placeHead = graphics.screen("place_head.frag", { FILLED: "" });
  const decoder = openDecoder(graphics);
  const smallRoom = graphics.texture("RGBA16F", 224, 160, { smooth: true });
  const smallTarget = graphics.target([smallRoom]);
  /** @typedef {Target & {image: Texture, drawn: string}} RoomImage @type {RoomImage | null} */
  let roomImage = null;
  /** What heads with the same avatar share, and how many they are.
   * @type {Map<Avatar, {body: AvatarBody, count: number}>} */
  const bodies = new Map();
  let [versions, composed] = [0, ""];

  /** Get ready to draw a head with an avatar. @param {Avatar} avatar @returns {Look} */
  function open(avatar) {
    decoder.add(avatar);
    const shared = bodies.get(avatar)
      ?? { body: openBody(graphics, programs, avatar, decoder), count: 0 };
    bodies.set(avatar, shared);
    shared.count += 1;
    const maps = openMaps(graphics, avatar);
    /** @type {Layer[]} */
    const layers = [];
    function free() {
      maps.free();
      layers.forEach((layer) => layer.free());
      shared.count -= 1;
      if (shared.count) return;
      shared.body.free();
      bodies.delete(avatar);
      decoder.remove(avatar);
    }
    return { avatar, body: shared.body, maps, layers, version: ++versions, free };
  }

  /** Decode heads; their maps are drawn from now on. @param {DecodeRequest[]} requests */
  function decode(requests) {
    decoder.decode(requests.map(({ look, isBoth, ...request }) => {
      const { positions, codes } = look.maps.of(request.level);
      look.maps.level = request.level;
      look.version = ++versions;
      return { ...request, avatar: look.avatar, positions: isBoth ? positions : null, codes };
    }));
  }

  /** Seconds that decoding a head takes here. @param {DecodeRequest} request Done before. */
  function measureDecode(request) {
    const wait = () => {
      const { codes } = request.look.maps.of(request.level);
      gl.bindFramebuffer(gl.FRAMEBUFFER, codes.framebuffer);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
    };
    wait();
    const started = performance.now();
    decode([request]);
    wait();
    return (performance.now() - started) / 1000;
  }

  /** What is on the screen of a head, and where.
   * @type {(placement: Placement, view: View, index: number) => Shown[]} */
  function shown(placement, { camera, rect: view }, index) {
    const { look, scale } = placement;
    const matrix = multiply(clipFromWorld(camera), placement.matrix);
    const rect = screenRect(matrix, look.body.outline, view);
    if (!rect || !look.maps.level) return [];
    const key = JSON.stringify([look.version, look.body.isSharp, ...matrix, rect, scale]);
    return [{ placement, index, matrix, view, rect, key, layer: layerOf(look, index, rect, scale) }];
  }

  /** A layer of the size of a head. @type {(look: Look, index: number, rect: Rect, scale: number)
   * => Layer} */
  function layerOf({ layers }, index, [left, bottom, right, top], scale) {
    const [width, height] = [Math.ceil(scale * (right - left)), Math.ceil(scale * (top - bottom))];
    const known = layers[index];
    const isServed = known?.scale === scale && serves(known.width, width)
      && serves(known.height, height);
    if (isServed) return known;
    known?.free();
    layers[index] = openLayer(graphics, stepped(width), stepped(height), scale);
    return layers[index];
  }

  /** Surface, pixels and what has a texture of one head; how many triangles. @param {Shown} shown */
  function drawLayer({ placement: { look: { body, maps } }, matrix, view, rect, key, layer }) {
    const { level } = maps;
    const { position, expression } = maps.of(level);
    const [decoded, textured] = [body.mesh(level, "decoded"), body.mesh(level, "textured")];
    const common =
      { clip_from_head: cropped(matrix, view, rect, layer), box_m: body.box, shown: body.fadeM };
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    graphics.into(layer.surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    if (decoded) graphics.drawMesh(programs.surface, decoded, { ...common, position_map: position });
    graphics.into(layer.coloured);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.disable(gl.CULL_FACE);
    body.colour(layer.coloured, { visible_xyz: layer.xyz, visible_uv: layer.uv,
      expression_map: expression, is_change: level < MAP_SIZE, shown: body.fadeM });
    gl.enable(gl.CULL_FACE);
    if (textured && body.skin) {
      graphics.drawMesh(programs.static, textured,
        { ...common, corner: [rect[0], rect[1]], skin: body.skin });
    }
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    layer.drawn = key;
    body.isDrawn = true;
    return ((decoded?.count ?? 0) + (textured?.count ?? 0)) / 3;
  }

  /** Draw the room where it looks different; its image.
   * @type {(views: View[], room: Room, target: Target) => RoomImage} */
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
    const drawn = hasRoom ? JSON.stringify([room, seen]) : "";
    if (drawn === roomImage.drawn) return roomImage;
    roomImage.drawn = drawn;
    const seats = new Float32Array(4 * MAX_SEATS);
    places.forEach((place, index) => seats.set([...place, room.speaking[index]], 4 * index));
    const lowest = places.length ? Math.min(...places.map((place) => place[1])) : 0;
    for (const { camera, rect } of seen) {
      graphics.draw(background, smallTarget, {
        seats, num_seats: places.length, table_m: lowest - TABLE_M,
        world_from_view: camera.axes.flat(), lens: camera.lens, eye_m: camera.centre,
      });
      graphics.draw(enlarge, roomImage, { image: smallRoom, rect: clipRect(rect, width, height) });
    }
    return roomImage;
  }

  /** The room, and over it all heads, the farthest first. @param {Shown[]} heads
   * @param {RoomImage} room @param {Target} target */
  function layOver(heads, room, target) {
    const { width, height } = target;
    for (const { rect, matrix, view, layer, placement: { fade, look } } of heads) {
      const key = layer.drawn + fade + room.drawn;
      if (layer.finished === key) continue;
      layer.finished = key;
      graphics.draw(finish, layer.finishing, {
        layer: layer.colour, step: 0.25, room: room.image, corner: [rect[0], rect[1], layer.scale],
        opacity: 1 - clamp(fade, 0, 1) * MAX_FADE, fading: fadingRows(look.body, matrix, view),
      });
    }
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, room.framebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target.framebuffer);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    heads.sort((a, b) => b.matrix[15] - a.matrix[15]);
    for (const { rect, layer } of heads) {
      const filled = [layer.width, layer.height].map((side, axis) =>
        (layer.scale * (rect[axis + 2] - rect[axis])) / side);
      const area = clipRect(rect, width, height);
      graphics.draw(placeHead, target, { layer: layer.shown, rect: area, filled });
    }
    gl.disable(gl.BLEND);
  }

  /** Draw a frame, if it looks other than the one before; heads without maps are left out.
   * @param {View[]} views @param {Room} room @param {Target} target */
  function draw(views, room, target) {
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    for (const { body } of bodies.values()) if (body.isDrawn && !body.isSharp) body.sharpen();
    const heads = views.flatMap((view, index) =>
      view.placements.flatMap((placement) => shown(placement, view, index)));
    const changed = heads.filter(({ key, layer }) => layer.drawn !== key);
    const triangles = changed.reduce((sum, head) => sum + drawLayer(head), 0);
    const behind = drawRoom(views, room, target);
    const whole = JSON.stringify([target, behind.drawn,
      heads.map(({ key, placement }) => [key, placement.fade])]);
    const isNew = whole !== composed;
    composed = whole;
    if (isNew) layOver(heads, behind, target);
    decoder.compile(); // with the room on the screen, while avatars are under way
    return { isNew, numDrawn: changed.length, triangles };
  }

  return { open, decode, measureDecode, draw };
}

/** Whether a side of a layer has room, and does not leave most empty. @param {number} own
 * @param {number} side */
const serves = (own, side) => (side <= own && own <= side + 2 * SIDE_STEP_PX)
  || own === stepped(side);
/** @param {number} side */
const stepped = (side) => Math.ceil(side / SIDE_STEP_PX) * SIDE_STEP_PX;
/** @type {(rect: Rect, width: number, height: number) => number[]} */
const clipRect = (rect, width, height) =>
  rect.map((side, index) => (2 * side) / (index % 2 ? height : width) - 1);

/** One head as one view sees it, from the lower left corner of its rectangle on.
 * @param {Graphics} graphics @param {number} width @param {number} height @param {number} scale Its
 * pixels for each of the picture. */
export function openLayer(graphics, width, height, scale) {
  const xyz = graphics.texture(graphics.exact, width, height);
  const uv = graphics.texture(graphics.pairs, width, height);
  const colour = graphics.texture("RGBA8", width, height);
  const shown = graphics.texture("RGBA8", width, height, { smooth: scale !== 1 });
  const depth = graphics.texture("DEPTH", width, height);
  const targets = {
    surface: graphics.target([xyz, uv], depth), coloured: graphics.target([colour], depth),
    finishing: graphics.target([shown]),
  };
  const free = () => graphics.free(...Object.values(targets), xyz, uv, colour, shown, depth);
  return { width, height, scale, xyz, uv, colour, shown, ...targets, free, drawn: "",
    finished: "" };
}

/** A row of a matrix times a point.
 * @type {(matrix: Matrix, row: number, point: number[]) => number} */
const times = (matrix, row, [x, y, z]) =>
  matrix[4 * row] * x + matrix[4 * row + 1] * y + matrix[4 * row + 2] * z + matrix[4 * row + 3];

/** The whole pixels that a box may cover, within the view; null if nothing is seen.
 * @type {(matrix: Matrix, box: number[][], view: Rect) => Rect | null} */
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
 * which all is there; then of the other.
 * @type {(body: AvatarBody, matrix: Matrix, view: Rect) => number[]} */
function fadingRows({ box, fadeM }, matrix, view) {
  const rows = fadeM.map((height) => [box[0], box[3]].flatMap((x) => [box[2], box[5]].map((z) => {
    const [y, w] = [1, 3].map((row) => times(matrix, row, [x, height, z]));
    return view[1] + ((view[3] - view[1]) * (clamp(y / Math.max(w, NEAR_M), -2, 2) + 1)) / 2;
  })));
  return [Math.max(...rows[0]), Math.max(...rows[1]) + 1, Math.min(...rows[0]),
    Math.min(...rows[1]) + 1];
}

/** The matrix to the clip space of a layer, which shows a rectangle of the view.
 * @type {(matrix: Matrix, view: Rect, rect: Rect, layer: Layer) => Float32Array} */
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
