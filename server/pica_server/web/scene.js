/**
 * The people of a call on their way to the canvas: who is ready, who sits where, what is decoded
 * and drawn, as `ui/avatar_presenter.py` does it; and the canvas, whose context may be lost.
 */

import { LEVELS } from "./avatar.js";
import { openRenderer } from "./draw.js";
import { openGraphics } from "./gl.js";
import { CostModel, Head, LISTENER_S, Scheduler, seeHeads } from "./schedule.js";
import { HOME, headRect, nearing, orbitLimits, planCamera, planSeats, SHOULDERS_M,
  USUAL_SPAN } from "./seats.js";
import { clamp, column, headMatrix } from "./space.js";
import { said } from "./wire.js";

const [MAX_PX, BUDGET_SHARE] = [3840 * 2160, 0.6];
const [SOFTWARE_FPS, DISPLAY_FPS] = [30, 60];
const FADE_OF_STATUS = { waiting: 0.6, live: 0, stale: 0.8, away: 0.4 };
const [FADE_S, GLOW_STEPS, SETTLE_S] = [0.5, 4, 0.15];
const SELF_SHARE = 0.2;

/** @typedef {View & {seated: {entry: Shape, matrix: Matrix}[]}} Stage */

/** What is kept of a person from frame to frame. */
class Shape {
  /** @type {Avatar | null} */
  avatar = null;
  /** @type {{head: Head, look: Look} | null} */
  ready = null;
  /** @type {Face | null} */
  face = null;
  shouldersM = SHOULDERS_M;
  span = USUAL_SPAN;
  problem = "";
  fade = FADE_OF_STATUS.waiting;
  glow = 0;
  turn = 0;
  isResting = false;
  scale = 1;
  /** @type {Matrix | null} */
  seat = null;

  /** @param {Person} person */
  constructor(person) {
    this.person = person;
  }
}

/** All that is on the GPU, and what is drawn of a call. */
export class Scene {
  costs = new CostModel();
  scheduler = new Scheduler(this.costs);
  numWhole = 0;
  /** @type {Map<string, Shape>} */
  entries = new Map();
  /** @type {{plan: SeatPlan, aspect: number} | null} */
  settled = null;
  drawnS = -Infinity;
  sinceS = 0;

  /** @param {Renderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
  }

  /** Plan, decode and draw a frame. @param {Person[]} people @param {Wanted} wanted
   * @param {Target} target @param {number} budgetS @param {number} now */
  draw(people, wanted, target, budgetS, now) {
    const { width, height } = target;
    const entries = this.refresh(wanted.self ? [...people, wanted.self] : people, now);
    const self = entries[people.length];
    entries.length = people.length;
    const plan = this.seat(entries, wanted, width / height);
    const camera = planCamera(plan, wanted.orbit, width, height,
      orbitLimits(plan, entries.map(({ span }) => span)));
    const seated = entries.map((entry, index) => ({ entry, matrix: plan.seats[index] }));
    /** @type {Stage[]} */
    const views = [{ camera, rect: [0, 0, width, height], seated, placements: [] }];
    if (self) {
      const side = Math.round(Math.min(width, height) * SELF_SHARE);
      const inset = Math.round(side / 10);
      const bottom = inset + Math.round(wanted.rise * height);
      const own = planSeats("grid", 1, 1);
      views.push({
        camera: planCamera(own, HOME, side, side, [0, 0, 0, 0]),
        rect: [inset, bottom, inset + side, bottom + side],
        seated: [{ entry: self, matrix: own.seats[0] }], placements: [],
      });
    }
    const labels = entries.map(({ person, face, ready }, index) =>
      ({ person, rect: headRect(camera, plan.seats[index]), hasFace: Boolean(ready && face) }));
    return { ...this.show(views, target, budgetS, now), labels };
  }

  /** Draw what the eyes of a headset see of people in these seats.
   * @type {(eyes: {camera: Camera, rect: Rect}[], people: Person[], seats: Matrix[], target: Target,
   * budgetS: number, now: number) => void} */
  drawFrom(eyes, people, seats, target, budgetS, now) {
    const entries = this.refresh(people, now);
    const seated = entries.map((entry, index) => ({ entry, matrix: seats[index] }));
    // Planned and decoded for the first eye.
    const [first, ...others] = eyes.map((eye) => ({ ...eye, seated, placements: [] }));
    const { placements } = first;
    this.show([first, ...others.map((eye) => ({ ...eye, seated: [], placements }))], target, budgetS,
      now);
  }

  /** Plan, decode and draw views, of which the first has the room.
   * @param {Stage[]} views @param {Target} target @param {number} budgetS @param {number} now */
  show(views, target, budgetS, now) {
    const heads = views.flatMap((view) => this.place(view));
    const { shadedPx } = this.scheduler.plan(heads.map(({ head }) => head), budgetS, now);
    heads.sort((a, b) => b.head.sight.headPx - a.head.sight.headPx);
    const requests = heads.flatMap(({ entry, head, look, placement }) => {
      entry.person.want(head.choice?.every ?? 1);
      // Who rests is not drawn again for another resolution alone.
      if (!entry.isResting) entry.scale = head.choice?.scale ?? 1;
      placement.scale = entry.scale;
      const request = head.request(now);
      return request ? [{ look, ...request }] : [];
    });
    this.renderer.decode(requests);
    const [{ seated }] = views;
    const room = { places: seated.map(({ matrix }) => column(matrix, 3)),
      speaking: seated.map(({ entry }) => Math.ceil(GLOW_STEPS * entry.glow) / GLOW_STEPS) };
    const drawn = this.renderer.draw(views, room, target);
    const decodesS = requests.reduce((sum, { level, isBoth }) =>
      sum + this.costs.decodeS(level, isBoth ? "both" : "expression"), 0);
    this.measure(requests);
    return { ...drawn, decodesS, shadedPx };
  }

  /** Learn once what a decode costs, when the first head has been shown.
   * @param {DecodeRequest[]} requests */
  measure(requests) {
    const whole = requests.find(({ isBoth }) => isBoth);
    if (!whole || this.numWhole++ !== 1) return;
    this.costs.observeDecode(this.renderer.measureDecode(whole), whole.level);
  }

  /** Take the faces of now; avatars are made ready, one a frame. @param {Person[]} people
   * @param {number} now */
  refresh(people, now) {
    [this.sinceS, this.drawnS] = [now - this.drawnS, now];
    for (const [id, { ready }] of this.entries) {
      if (people.some((person) => person.id === id)) continue;
      ready?.look.free();
      this.entries.delete(id);
    }
    let hasAdded = false;
    return people.map((person, index) => {
      const entry = this.entries.get(person.id) ?? new Shape(person);
      this.entries.set(person.id, entry);
      entry.person = person;
      if (person.avatar && person.avatar !== entry.avatar && !hasAdded) {
        hasAdded = true;
        this.dress(entry, person.avatar);
      }
      const face = person.faceAt(now);
      // While not everybody can be drawn at every face, listeners keep theirs for a turn.
      const turn = Math.floor(now / LISTENER_S + index / people.length);
      const isWaiting = this.scheduler.isShort && !person.isSpeaking && turn === entry.turn;
      entry.isResting = Boolean(isWaiting && entry.face && face);
      entry.turn = turn;
      entry.face = entry.isResting ? entry.face : face;
      return entry;
    });
  }

  /** Put a person's avatar on the GPU. @param {Shape} entry @param {Avatar} avatar */
  dress(entry, avatar) {
    entry.ready?.look.free();
    Object.assign(entry, { avatar, ready: null, problem: "" });
    try {
      const look = this.renderer.open(avatar);
      const numTriangles = LEVELS.map((level) => avatar.faces(level).length / 3);
      entry.ready = { look, head: new Head(avatar.manifest, numTriangles) };
      entry.shouldersM = avatar.bust().widthM;
      entry.span = avatar.manifest.view_span;
    } catch (error) {
      entry.problem = said(error);
    }
  }

  /** Seats on their way to where people should be; at once on a picture of another size.
   * @type {(entries: Shape[], wanted: Wanted, aspect: number) => SeatPlan} */
  seat(entries, { layout, pinned, free, isCalm }, aspect) {
    const shouldersM = entries.length ? Math.max(...entries.map((entry) => entry.shouldersM))
      : SHOULDERS_M;
    const place = entries.findIndex(({ person }) => person.id === pinned);
    let plan = planSeats(layout, entries.length, aspect, free, place, shouldersM);
    if (this.settled?.aspect === aspect && entries.some(({ seat }) => seat)) {
      const seats = plan.seats.map((seat, index) => entries[index].seat ?? seat);
      plan = nearing({ ...this.settled.plan, seats }, plan,
        isCalm ? 1 : 1 - Math.exp(-this.sinceS / SETTLE_S));
    }
    this.settled = { plan, aspect };
    entries.forEach((entry, index) => (entry.seat = plan.seats[index]));
    return plan;
  }

  /** Give a view its placements; the heads that can be drawn. @param {Stage} view */
  place({ camera, seated, placements }) {
    const step = this.sinceS / FADE_S;
    const heads = seated.flatMap(({ entry, matrix: seat }) => {
      const { face, person, ready } = entry;
      entry.fade += clamp(FADE_OF_STATUS[face?.status ?? "waiting"] - entry.fade, -step, step);
      entry.glow += clamp((person.isSpeaking ? 1 : 0) - entry.glow, -step, step);
      if (!ready) return [];
      const { head, look } = ready;
      const matrix = headMatrix(seat, face?.values.subarray(256) ?? [0, 0, 0, 0, 0, 0]);
      const placement = { look, matrix, fade: entry.fade, scale: 1 };
      placements.push(placement);
      if (!face) return [];
      [head.matrix, head.latent, head.isListening] =
        [matrix, face.values.subarray(0, 256), !person.isSpeaking];
      return [{ entry, head, look, placement }];
    });
    seeHeads(heads.map(({ head }) => head), camera);
    return heads;
  }
}

/** The canvas of a call: its size, its context that may be lost, and frame after frame. */
export class Picture {
  numDrawn = 0;
  /** Whether it is seen in a headset. */
  isAway = false;
  /** @type {WebGLSync | null} */
  fence = null;

  /**
   * @param {HTMLCanvasElement} canvas @param {Record<string, string>} texts Of the shaders.
   * @param {boolean} isTile Without a room.
   * @throws {Error} This browser cannot draw.
   */
  constructor(canvas, texts, isTile) {
    const gl = canvas.getContext("webgl2",
      { antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new Error(
      "This browser draws no 3D (WebGL 2): try a current Firefox, Chrome or Safari.");
    this.canvas = canvas;
    this.gl = gl;
    const open = () => {
      const graphics = openGraphics(gl, texts);
      this.fps = graphics.isSoftware ? SOFTWARE_FPS : DISPLAY_FPS;
      return new Scene(openRenderer(graphics, !isTile));
    };
    /** All that is on the GPU, made again after a context was lost. */
    this.scene = open();
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.fence = null;
    });
    canvas.addEventListener("webglcontextrestored", () => (this.scene = open()));
  }

  /** Why an avatar cannot be drawn; empty if nothing is wrong. @param {Person} person */
  problemOf({ id }) {
    return this.scene.entries.get(id)?.problem ?? "";
  }

  /**
   * Draw a frame unless the one before is still being drawn, or the context is lost; where
   * everybody is, in pixels of the page.
   * @param {Person[]} people @param {Wanted} wanted @param {number} now Seconds.
   * @returns {Label[] | null}
   */
  draw(people, wanted, now) {
    if (this.fence || this.isAway || this.gl.isContextLost()) return null;
    const ratio = this.resize();
    const { width, height } = this.canvas;
    const started = performance.now();
    const found = this.scene.draw(people, wanted, { framebuffer: null, width, height },
      BUDGET_SHARE / (this.fps ?? DISPLAY_FPS), now);
    if (found.isNew) {
      ++this.numDrawn;
      this.whenDone(() => {
        const seconds = (performance.now() - started) / 1000 - found.decodesS;
        this.scene.costs.observeDraw(found.triangles, found.shadedPx, seconds);
      });
    }
    return found.labels.map(({ rect, ...label }) =>
      ({ ...label, rect: rect && rect.map((value) => value / ratio) }));
  }

  /** Do something when the GPU is done with a frame. @param {() => void} act */
  whenDone(act) {
    const { gl } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.fence = fence;
    gl.flush();
    const look = () => {
      if (!fence || this.fence !== fence) return;
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED) {
        gl.deleteSync(fence);
        this.fence = null;
        act();
      } else {
        setTimeout(look, 1);
      }
    };
    setTimeout(look, 1);
  }

  /** Make the canvas as large as it is shown; pixels of it for one of the page. */
  resize() {
    const { canvas, canvas: { clientWidth, clientHeight } } = this;
    const ratio = Math.min(window.devicePixelRatio || 1,
      Math.sqrt(MAX_PX / Math.max(clientWidth * clientHeight, 1)));
    const [width, height] =
      [clientWidth, clientHeight].map((side) => Math.max(Math.round(side * ratio), 1));
    const isOther = canvas.width !== width || canvas.height !== height;
    if (isOther) Object.assign(canvas, { width, height });
    return ratio;
  }
}
