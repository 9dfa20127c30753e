/**
 * Draws heads: what is visible first, then the pixel decoder on exactly those pixels. Each head that
 * has changed is drawn into a layer of its own; all layers are laid over the room, the farthest first
 * (`render/renderer.py` and `render/passes.py`, whose text the shaders are).
 */

import { Body, HeadMaps, Placeholder } from "./body.js";
import { Decoder } from "./decode.js";
import { UNITS } from "./gl.js";
import { compose } from "./glsl.js";
import { clipFromWorld, lookAt, multiply, NEAR_M } from "./space.js";

/** @import { Avatar } from "./avatar.js" */
/** @import { Graphics, Program, Target, Texture } from "./gl.js" */
/** @import { Camera, Matrix } from "./space.js" */
/** @typedef {[number, number, number, number]} Rect Left, bottom, right, top in pixels, rows from the bottom. */
/** @typedef {{camera: Camera, rect: Rect, slots?: Set<string>}} View What a camera sees where; of these slots alone. */
/** @typedef {{places: import("./space.js").Vector[], speaking: number[]}} Room */
/** @typedef {{avatar: Avatar | null, body: Body | Placeholder, maps: HeadMaps | null, version: number}} Slot */
/**
 * @typedef {object} Placement One head of a frame.
 * @property {string} slot
 * @property {Matrix} matrix Head frame to world.
 * @property {number} fade 0 is as it is, 1 has faded into the room.
 * @property {number} scale Share of the resolution.
 */
/**
 * @typedef {object} Shown One head in one view.
 * @property {string} key
 * @property {Slot} entry
 * @property {Placement} placement
 * @property {Matrix} matrix To clip space of the view.
 * @property {Rect} view
 * @property {Rect} rect
 * @property {number} level Of its maps; 0 for the placeholder.
 * @property {number[]} fadingRows
 * @property {string} look All that its layer depends on.
 */

const [SIDE_STEP_PX, EDGE_PX, MAX_FADE, TABLE_M, MAX_SEATS] = [32, 1, 0.75, 0.31, 16];
const STILL = lookAt([0, 0, 1.1], [0, 0, 0], 0.56, 16, 9);

export class Renderer {
  /** @param {Graphics} graphics @param {{hasRoom?: boolean}} [options] Without a room the ground is transparent. */
  constructor(graphics, { hasRoom = true } = {}) {
    this._graphics = graphics;
    this._hasRoom = hasRoom;
    const { texts } = graphics;
    const surface = compose(texts, "surface.frag");
    const mesh = compose(texts, "mesh.vert");
    /** @type {import("./body.js").MeshPrograms} */
    this._programs = {
      surface: graphics.program(compose(texts, "mesh.vert", { MAPPED: "" }), surface),
      static: graphics.program(mesh, compose(texts, "textured.frag")),
      unwrap: graphics.program(compose(texts, "unwrap.vert"), surface),
    };
    this._background = graphics.screen("background.frag");
    this._enlarge = graphics.screen("enlarge.frag");
    this._placeFading = graphics.screen("place_head.frag", { FADING: "" });
    this._placeWhole = graphics.screen("place_head.frag");
    this._smooth = graphics.screen("smooth_edges.frag");
    this._decoder = new Decoder(graphics);
    this._placeholder = new Placeholder(graphics);
    const small = graphics.texture("RGBA16F", 224, 160, { smooth: true });
    this._smallRoom = graphics.target([small]);
    this._smallRoomImage = small;
    /** @type {{image: Texture, target: Target, drawn: string} | null} */
    this._room = null;
    /** @type {Map<string, Slot>} */
    this._slots = new Map();
    /** @type {Map<string, Layer>} */
    this._layers = new Map();
    this._versions = 0;
    this._composed = "";
  }

  /** Put an avatar into a slot; null is a placeholder. Slots with the same avatar share. @param {string} slot @param {Avatar | null} avatar */
  add(slot, avatar) {
    this.remove(slot);
    /** @type {Slot} */
    const entry = { avatar, body: this._placeholder, maps: null, version: ++this._versions };
    if (avatar) {
      this._decoder.add(avatar);
      const alike = [...this._slots.values()].find((each) => each.avatar === avatar);
      entry.body = alike?.body ?? new Body(this._graphics, this._programs, avatar, this._decoder);
      entry.maps = new HeadMaps(this._graphics, avatar);
    }
    this._slots.set(slot, entry);
  }

  /** @param {string} slot */
  remove(slot) {
    const gone = this._slots.get(slot);
    this._slots.delete(slot);
    gone?.maps?.free();
    const isShared = [...this._slots.values()].some(({ body }) => body === gone?.body);
    if (gone?.avatar && gone.body instanceof Body && !isShared) {
      gone.body.free();
      this._decoder.remove(gone.avatar);
    }
  }

  /** Decode heads; their maps are drawn from now on. @param {{slot: string, latent: Float32Array, view: ArrayLike<number>, level: number, isBoth: boolean}[]} requests */
  decode(requests) {
    this._decoder.decode(requests.flatMap(({ slot, latent, view, level, isBoth }) => {
      const entry = this._slots.get(slot);
      if (!entry?.avatar || !entry.maps) {
        return [];
      }
      const maps = entry.maps.of(level);
      entry.maps.level = level;
      entry.version = ++this._versions;
      return [{ avatar: entry.avatar, latent, view, level, positions: isBoth ? maps.positions : null, codes: maps.codes }];
    }));
  }

  /** Seconds that decoding a head at the full level takes here. @param {string} slot */
  measureDecode(slot) {
    const { gl } = this._graphics;
    const maps = /** @type {HeadMaps} */ (this._slots.get(slot)?.maps);
    /** @param {number} times */
    const took = (times) => {
      const started = performance.now();
      for (let time = 0; time < times; ++time) {
        this.decode([{ slot, latent: new Float32Array(256), view: [0, 0, 1], level: 256, isBoth: true }]);
      }
      gl.bindFramebuffer(gl.FRAMEBUFFER, maps.of(256).codes.framebuffer);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));
      return (performance.now() - started) / 1000;
    };
    took(1);
    const seconds = took(3) / 3;
    maps.level = 0;
    return seconds;
  }

  /**
   * Draw a frame into the canvas, or into a target, if it looks other than the one before.
   * @param {Placement[]} placements Heads in any order; unknown slots are left out.
   * @param {View[]} views The picture's one, or one for each eye.
   * @param {Room} room @param {Target} target
   */
  draw(placements, views, room, target) {
    const { gl } = this._graphics;
    gl.disable(gl.BLEND);
    gl.disable(gl.SCISSOR_TEST);
    gl.cullFace(gl.BACK);
    gl.clearColor(0, 0, 0, 0);
    const shown = views.flatMap((view) => placements
      .filter(({ slot }) => view.slots?.has(slot) ?? true)
      .flatMap((placement) => this._shown(placement, view)));
    const changed = this._withLayers(shown);
    for (const [head, layer] of changed) {
      this._drawLayer(head, layer);
    }
    const isNewRoom = this._drawRoom(views, room, target);
    const composed = JSON.stringify([target.width, target.height, shown.map(({ key, rect, placement }) => [key, rect, placement.fade])]);
    const isNew = isNewRoom || changed.length > 0 || composed !== this._composed || target.framebuffer !== null;
    if (isNew) {
      this._compose(shown, target);
      this._composed = composed;
    }
    const triangles = changed.reduce((sum, [head]) => sum + trianglesOf(head), 0);
    return { isNew, numDrawn: changed.length, triangles };
  }

  /** What is on the screen of a head, and where. @param {Placement} placement @param {View} view @returns {Shown[]} */
  _shown(placement, { camera, rect: view }) {
    const entry = this._slots.get(placement.slot);
    if (!entry) {
      return [];
    }
    const level = entry.maps?.level ?? 0;
    const own = level ? entry : { ...entry, body: this._placeholder };
    const matrix = multiply(clipFromWorld(camera), placement.matrix);
    const covered = screenRect(matrix, own.body.outline, view);
    if (!covered) {
      return [];
    }
    const look = JSON.stringify([entry.version, ...matrix, covered, placement.scale]);
    const fadingRows = fadingRowsOf(own.body, matrix, view);
    return [{ key: `${view[0]} ${placement.slot}`, entry: own, placement, matrix, view, rect: covered, level, fadingRows, look }];
  }

  /** Heads whose layers are to be drawn, with these; what no head needs any more is freed. @param {Shown[]} shown @returns {[Shown, Layer][]} */
  _withLayers(shown) {
    const kept = new Map(shown.flatMap((head) => {
      const layer = this._layers.get(head.key);
      return layer?.serves(sizeOf(head), head.placement.scale) ? [[head.key, layer]] : [];
    }));
    for (const [key, layer] of this._layers) {
      if (kept.get(key) !== layer) {
        layer.free();
      }
    }
    for (const head of shown) {
      if (!kept.has(head.key)) {
        kept.set(head.key, new Layer(this._graphics, layerSize(sizeOf(head)), head.placement.scale));
      }
    }
    this._layers = kept;
    return shown.flatMap((head) => {
      const layer = /** @type {Layer} */ (kept.get(head.key));
      return layer.look === head.look ? [] : [/** @type {[Shown, Layer]} */ ([head, layer])];
    });
  }

  /** Surface, pixels, what has a texture, and the silhouette of one head. @param {Shown} head @param {Layer} layer */
  _drawLayer(head, layer) {
    const { _graphics: graphics } = this;
    const { gl } = graphics;
    const { body, maps } = head.entry;
    const matrix = cropped(head, layer);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    graphics.use(layer.surface);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const decoded = body instanceof Body && head.level ? body.decoded(head.level) : null;
    if (decoded && maps) {
      const { position } = maps.of(head.level);
      graphics.bind(UNITS.position_map, position);
      this._drawMesh(this._programs.surface, decoded, body, matrix);
    }
    graphics.use(layer.coloured);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (decoded && maps && body instanceof Body) {
      body.bind();
      graphics.bind(UNITS.expression_map, maps.of(head.level).expression);
      graphics.bind(UNITS.visible_xyz, layer.xyz);
      graphics.bind(UNITS.visible_uv, layer.uv);
      gl.useProgram(body.shade.program);
      gl.uniform1i(body.shade.at.is_change, head.level < body.stillSize ? 1 : 0);
      gl.uniform2f(body.shade.at.shown, body.fadeM[0], body.fadeM[1]);
      // Only where some mesh lies before the far plane.
      gl.depthFunc(gl.GREATER);
      gl.depthMask(false);
      gl.disable(gl.CULL_FACE);
      graphics.drawScreen(body.shade, layer.coloured);
      gl.depthFunc(gl.LESS);
      gl.depthMask(true);
      gl.enable(gl.CULL_FACE);
    }
    const textured = body.textured(head.level);
    if (textured && body.skin) {
      const { program, at } = this._programs.static;
      gl.useProgram(program);
      gl.uniform2f(at.corner, head.rect[0], head.rect[1]);
      gl.uniform2f(at.shown, body.fadeM[0], body.fadeM[1]);
      graphics.bind(UNITS.skin, body.skin);
      this._drawMesh(this._programs.static, textured, body, matrix);
    }
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    graphics.bind(UNITS.layer, layer.colour);
    graphics.drawScreen(this._smooth, layer.smoothed);
    layer.look = head.look;
  }

  /** @param {Program} program @param {import("./body.js").Triangles} mesh @param {Body | Placeholder} body @param {Matrix} matrix */
  _drawMesh({ program, at }, mesh, body, matrix) {
    const { gl } = this._graphics;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at.clip_from_head, true, matrix);
    gl.uniform3fv(at.box_m, body.box);
    gl.bindVertexArray(mesh.vertices);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }

  /** Draw the room where it looks different; whether it did. @param {View[]} views @param {Room} room @param {Target} target */
  _drawRoom(views, room, { width, height }) {
    const { _graphics: graphics } = this;
    const { gl } = graphics;
    if (this._room?.target.width !== width || this._room.target.height !== height) {
      graphics.free(this._room?.image, this._room?.target);
      const image = graphics.texture("RGBA8", width, height);
      this._room = { image, target: graphics.target([image]), drawn: "" };
      graphics.use(this._room.target);
      gl.clear(gl.COLOR_BUFFER_BIT);
    }
    const places = room.places.slice(0, MAX_SEATS);
    const seen = views.map(({ camera, rect }) => ({ camera: places.length ? camera : STILL, rect }));
    const drawn = JSON.stringify([room, seen]);
    if (drawn === this._room.drawn || !this._hasRoom) {
      return false;
    }
    this._room.drawn = drawn;
    const seats = new Float32Array(4 * MAX_SEATS);
    places.forEach((place, index) => seats.set([...place, room.speaking[index]], 4 * index));
    for (const { camera, rect } of seen) {
      const { program, at } = this._background;
      gl.useProgram(program);
      gl.uniform4fv(at.seats, seats);
      gl.uniform1i(at.num_seats, places.length);
      gl.uniform1f(at.table_m, Math.min(...places.map((place) => place[1]), places.length ? Infinity : 0) - TABLE_M);
      gl.uniformMatrix3fv(at.world_from_view, false, camera.axes.flat());
      gl.uniform4fv(at.lens, camera.lens);
      gl.uniform3fv(at.eye_m, camera.centre);
      graphics.drawScreen(this._background, this._smallRoom);
      graphics.bind(UNITS.image, this._smallRoomImage);
      gl.useProgram(this._enlarge.program);
      gl.uniform4fv(this._enlarge.at.rect, clipRect(rect, width, height));
      graphics.drawScreen(this._enlarge, this._room.target);
    }
    return true;
  }

  /** The room, and over it all heads, the farthest first. @param {Shown[]} shown @param {Target} target */
  _compose(shown, target) {
    const { _graphics: graphics } = this;
    const { gl } = graphics;
    const { width, height } = target;
    const room = /** @type {NonNullable<typeof this._room>} */ (this._room);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, room.target.framebuffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target.framebuffer);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    graphics.bind(UNITS.room, room.image);
    for (const head of [...shown].sort((a, b) => b.matrix[15] - a.matrix[15])) {
      const layer = /** @type {Layer} */ (this._layers.get(head.key));
      graphics.bind(UNITS.layer, layer.smooth);
      // Over a transparent ground there is nothing to fade into.
      const screen = this._hasRoom ? this._placeFading : this._placeWhole;
      const [columns, rows] = [head.rect[2] - head.rect[0], head.rect[3] - head.rect[1]];
      gl.useProgram(screen.program);
      gl.uniform4fv(screen.at.rect, clipRect(head.rect, width, height));
      gl.uniform2f(screen.at.filled, (layer.scale * columns) / layer.width, (layer.scale * rows) / layer.height);
      if (this._hasRoom) {
        gl.uniform1f(screen.at.opacity, 1 - Math.min(Math.max(head.placement.fade, 0), 1) * MAX_FADE);
        gl.uniform4fv(screen.at.fading, head.fadingRows);
      }
      graphics.drawScreen(screen, target);
    }
    gl.disable(gl.BLEND);
  }
}

/** One head as one view sees it; its lower left corner is that of the head's rectangle. */
class Layer {
  /** @param {Graphics} graphics @param {[number, number]} size @param {number} scale Its pixels for each of the picture. */
  constructor(graphics, [width, height], scale) {
    this._graphics = graphics;
    this.width = width;
    this.height = height;
    this.scale = scale;
    this.xyz = graphics.texture(graphics.exact, width, height);
    this.uv = graphics.texture(graphics.pairs, width, height);
    this.colour = graphics.texture("RGBA8", width, height);
    this.smooth = graphics.texture("RGBA8", width, height, { smooth: scale !== 1 });
    this._depth = graphics.texture("DEPTH", width, height);
    this.surface = graphics.target([this.xyz, this.uv], this._depth);
    this.coloured = graphics.target([this.colour], this._depth);
    this.smoothed = graphics.target([this.smooth]);
    this.look = "";
  }

  /** Whether a head of a size fits, and does not leave most empty. @param {[number, number]} size @param {number} scale */
  serves(size, scale) {
    const own = [this.width, this.height];
    const fits = size.every((side, axis) => side <= own[axis] && own[axis] <= side + 2 * SIDE_STEP_PX);
    return scale === this.scale && (fits || layerSize(size).every((side, axis) => side === own[axis]));
  }

  free() {
    this._graphics.free(this.surface, this.coloured, this.smoothed, this.xyz, this.uv, this.colour, this.smooth, this._depth);
  }
}

/** @param {Shown} head @returns {[number, number]} */
const sizeOf = ({ rect, placement: { scale } }) => [Math.ceil(scale * (rect[2] - rect[0])), Math.ceil(scale * (rect[3] - rect[1]))];
/** @param {[number, number]} size @returns {[number, number]} */
const layerSize = (size) => [Math.ceil(size[0] / SIDE_STEP_PX) * SIDE_STEP_PX, Math.ceil(size[1] / SIDE_STEP_PX) * SIDE_STEP_PX];
/** @param {Rect} rect @param {number} width @param {number} height */
const clipRect = ([left, bottom, right, top], width, height) => [(2 * left) / width - 1, (2 * bottom) / height - 1, (2 * right) / width - 1, (2 * top) / height - 1];

/** @param {Shown} head */
function trianglesOf({ entry: { body }, level }) {
  const decoded = body instanceof Body && level ? body.decoded(level)?.count ?? 0 : 0;
  return (decoded + (body.textured(level)?.count ?? 0)) / 3;
}

/** The whole pixels that a box may cover, within the view; null if nothing is seen. @param {Matrix} matrix @param {number[][]} box @param {Rect} view @returns {Rect | null} */
function screenRect(matrix, box, view) {
  const clip = box.map((point) => [0, 1, 3].map((row) => matrix[4 * row] * point[0] + matrix[4 * row + 1] * point[1] + matrix[4 * row + 2] * point[2] + matrix[4 * row + 3]));
  if (!clip.flat().every(Number.isFinite) || clip.every(([, , w]) => w <= NEAR_M)) {
    return null;
  }
  if (clip.some(([, , w]) => w <= NEAR_M)) {
    return view;
  }
  const [x, y] = [0, 1].map((axis) => clip.map((point) => point[axis] / point[2]));
  const [width, height] = [view[2] - view[0], view[3] - view[1]];
  /** @type {Rect} */
  const rect = [
    Math.max(view[0] + Math.floor(((Math.min(...x) + 1) / 2) * width) - EDGE_PX, view[0]),
    Math.max(view[1] + Math.floor(((Math.min(...y) + 1) / 2) * height) - EDGE_PX, view[1]),
    Math.min(view[0] + Math.ceil(((Math.max(...x) + 1) / 2) * width) + EDGE_PX, view[2]),
    Math.min(view[1] + Math.ceil(((Math.max(...y) + 1) / 2) * height) + EDGE_PX, view[3]),
  ];
  return rect[0] < rect[2] && rect[1] < rect[3] ? rect : null;
}

/** Rows of the picture at which nothing is left of the side of a bust that fades first, and from which all is there; then of the other. @param {{lowM: number[], highM: number[], fadeM: number[]}} body @param {Matrix} matrix @param {Rect} view */
function fadingRowsOf({ lowM, highM, fadeM }, matrix, view) {
  const rows = fadeM.map((height) => [0, 1, 2, 3].map((corner) => {
    const [x, z] = [(corner & 1 ? highM : lowM)[0], (corner & 2 ? highM : lowM)[2]];
    const [y, w] = [1, 3].map((row) => matrix[4 * row] * x + matrix[4 * row + 1] * height + matrix[4 * row + 2] * z + matrix[4 * row + 3]);
    return view[1] + ((view[3] - view[1]) * (Math.min(Math.max(y / Math.max(w, NEAR_M), -2), 2) + 1)) / 2;
  }));
  return [Math.max(...rows[0]), Math.max(...rows[1]) + 1, Math.min(...rows[0]), Math.min(...rows[1]) + 1];
}

/** The matrix to the clip space of a layer, which shows the head's rectangle of the view. @param {Shown} head @param {Layer} layer @returns {Matrix} */
function cropped({ matrix, view, rect }, layer) {
  const found = Float64Array.from(matrix);
  for (const axis of [0, 1]) {
    const side = view[axis + 2] - view[axis];
    const scale = layer.scale / (axis ? layer.height : layer.width);
    const moved = (2 * (view[axis] - rect[axis]) + side) * scale - 1;
    for (let column = 0; column < 4; ++column) {
      found[4 * axis + column] = side * scale * matrix[4 * axis + column] + moved * matrix[12 + column];
    }
  }
  return found;
}
