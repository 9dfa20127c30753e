/** What the user sees and does in a call: names, the bar of buttons, keys and gestures. */

import { HOME, LAYOUTS } from "./seats.js";
import { said } from "./wire.js";

const [ORBIT_PER_PX, MAX_ORBIT, ZOOM_PER_STEP, KEY_STEP_PX, TAP_PX] = [0.005, 1.3, 1.1, 24, 6];
const [MIN_ZOOM, MAX_ZOOM] = [0.4, 12];
const [BAR_PX, LABEL_PX, FADES_BELOW, NARROW_PX] = [70, 52, 0.3, 800];

/** @template {HTMLElement} [T=HTMLElement] @param {string} id @returns {T} */
export const element = (id) => /** @type {any} */ (document.getElementById(id));

/** The room of a call on the page, until it is closed. */
export class CallView {
  showsSelf = true;
  /** @type {Map<string, HTMLElement>} */
  buttons = new Map();
  /** @type {Label[]} */
  shown = [];
  /** @type {Map<number, {x: number, y: number}>} */
  pointers = new Map();
  movedPx = 0;
  stop = new AbortController();

  /** @param {Call} call @param {Picture} picture */
  constructor(call, picture) {
    this.call = call;
    this.picture = picture;
    /** @type {Wanted} */
    this.wanted = { layout: "line", pinned: "", orbit: { ...HOME }, free: 0, self: null, rise: 0,
      isCalm: false };
    this.listen();
    this.refresh();
    const { xr } = /** @type {any} */ (navigator);
    xr?.isSessionSupported("immersive-vr").then((/** @type {boolean} */ isThere) => {
      element("headset").hidden = !isThere;
    }, () => {});
  }

  close() {
    this.stop.abort();
    this.buttons.forEach((button) => button.remove());
  }

  /** Show how the call stands. */
  refresh() {
    const { call: { status, voice, self, members, camera }, wanted } = this;
    const bar = BAR_PX / Math.max(window.innerHeight, 1);
    wanted.self = this.showsSelf ? self : null;
    wanted.rise = window.innerWidth < NARROW_PX ? bar : 0;
    wanted.free = Math.min(bar, 0.2);
    const { yaw, pitch, zoom } = wanted.orbit;
    element("reset").hidden = wanted.pinned === "" && zoom === 1 && yaw === 0 && pitch === 0;
    element("hear").hidden = !voice.needsTap;
    element("mute").textContent = voice.isMuted ? "Unmute" : "Mute";
    element("mute").setAttribute("aria-pressed", String(!voice.isMuted));
    element("self").hidden = element("camera").hidden = !self;
    element("camera").setAttribute("aria-pressed", String(camera?.isOpen ?? false));
    element("self").setAttribute("aria-pressed", String(this.showsSelf));
    element("layout").textContent = `Layout: ${wanted.layout}`;
    const isJoined = status.state === "joined";
    const lines = [
      isJoined ? "" : status.reason || `${status.state} …`, voice.note,
      camera?.note ?? "",
      isJoined && !members.size ? "Nobody else is here yet." : "",
    ];
    const notice = lines.filter(Boolean).join(" ");
    if (element("notice").textContent !== notice) element("notice").textContent = notice;
    element("code").textContent = status.code && `Encrypted: ${status.code}`;
  }

  /** Put names below heads. @param {Label[]} labels */
  place(labels) {
    this.shown = labels;
    for (const [id, button] of this.buttons) {
      if (labels.some(({ person }) => person.id === id)) continue;
      button.remove();
      this.buttons.delete(id);
    }
    for (const { person, rect, hasFace } of labels) {
      const button = this.buttonOf(person, hasFace);
      button.hidden = rect === null;
      if (!rect) continue;
      const [left, top, right, bottom] = rect;
      // Where a bust fades.
      const below = bottom + FADES_BELOW * (bottom - top);
      const [x, y] = [(left + right) / 2, Math.min(below, window.innerHeight - BAR_PX - LABEL_PX)];
      button.style.transform = `translate(${Math.round(x)}px, ${Math.round(y)}px) translateX(-50%)`;
      const disc = /** @type {HTMLElement} */ (button.firstElementChild);
      const [wide, middle] = [right - left, (top + bottom) / 2 - y];
      disc.style.cssText = `width: ${wide}px; top: ${middle}px; font-size: ${wide / 2}px`;
    }
  }

  /** @param {Person} person @param {boolean} hasFace */
  buttonOf(person, hasFace) {
    let button = this.buttons.get(person.id);
    if (!button) {
      const copy =
        document.importNode(/** @type {HTMLTemplateElement} */ (element("label")).content, true);
      button = /** @type {HTMLElement} */ (copy.firstElementChild);
      button.addEventListener("click", () => this.pin(person.id));
      element("labels").append(button);
      this.buttons.set(person.id, button);
    }
    const { name, isSpeaking } = person;
    const state = this.picture.problemOf(person) || person.state;
    const isPinned = this.wanted.pinned === person.id;
    const facts = [name, isSpeaking ? "speaking" : "", state].filter(Boolean).join(", ");
    const said = `${facts}: ${isPinned ? "show all" : "show large"}`;
    if (button.ariaLabel !== said || button.classList.contains("faceless") === hasFace) {
      const [disc, label, small] = button.children;
      [disc.textContent, label.textContent, small.textContent] = [[...name][0], name, state];
      button.title = state ? `${name}: ${state}` : name;
      button.ariaLabel = said;
      button.ariaPressed = String(isPinned);
      button.classList.toggle("speaking", isSpeaking);
      button.classList.toggle("faceless", !hasFace);
    }
    return button;
  }

  /** Show one large, or no longer. @param {string} id */
  pin(id) {
    this.wanted.pinned = this.wanted.pinned === id ? "" : id;
    this.refresh();
  }

  async toggleVoice() {
    const { voice } = this.call;
    await (voice.isMuted ? voice.speak() : voice.mute(true));
    this.refresh();
  }

  /** @param {number} right @param {number} down Pixels that the scene was dragged. */
  orbit(right, down) {
    const { orbit } = this.wanted;
    /** @param {number} angle */
    const limited = (angle) => Math.min(Math.max(angle, -MAX_ORBIT), MAX_ORBIT);
    orbit.yaw = limited(orbit.yaw - right * ORBIT_PER_PX);
    orbit.pitch = limited(orbit.pitch + down * ORBIT_PER_PX);
    this.refresh();
  }

  /** @param {number} ratio */
  zoom(ratio) {
    this.wanted.orbit.zoom = Math.min(Math.max(this.wanted.orbit.zoom * ratio, MIN_ZOOM), MAX_ZOOM);
    this.refresh();
  }

  listen() {
    const { signal } = this.stop;
    const { canvas } = this.picture;
    /** @type {Record<string, () => void>} */
    const actions = {
      hear: () => void this.call.voice.start().then(() => this.refresh()),
      mute: () => void this.toggleVoice(),
      layout: () => {
        this.wanted.layout = LAYOUTS[(LAYOUTS.indexOf(this.wanted.layout) + 1) % LAYOUTS.length];
      },
      self: () => {
        this.showsSelf = !this.showsSelf;
      },
      headset: () => void import("./xr.js").then(({ enterHeadset }) =>
        enterHeadset(this.picture, () => this.call.participants)).catch((error) =>
        this.call.voice.say(`no headset: ${said(error)}`)),
      camera: () => void this.call.toggleCamera(),
      reset: () => Object.assign(this.wanted, { pinned: "", orbit: { ...HOME } }),
      leave: () => this.call.leave(),
    };
    for (const [id, act] of Object.entries(actions)) {
      element(id).addEventListener("click", () => {
        act();
        this.refresh();
      }, { signal });
    }
    for (const event of ["people", "status", "voice", "camera"]) {
      this.call.addEventListener(event, () => this.refresh(), { signal });
    }
    window.addEventListener("resize", () => this.refresh(), { signal });
    document.addEventListener("keydown", (event) => this.key(event), { signal });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(ZOOM_PER_STEP ** -Math.sign(event.deltaY));
    }, { signal, passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
      this.movedPx = this.pointers.size > 1 ? Infinity : 0;
    }, { signal });
    canvas.addEventListener("pointermove", (event) => this.drag(event), { signal });
    canvas.addEventListener("pointercancel", ({ pointerId }) => this.pointers.delete(pointerId),
      { signal });
    canvas.addEventListener("pointerup", ({ pointerId, offsetX: x, offsetY: y }) => {
      this.pointers.delete(pointerId);
      const hit = this.shown.find(({ rect }) => rect && rect[0] <= x && x <= rect[2] && rect[1] <= y
        && y <= rect[3]);
      if (hit && this.movedPx < TAP_PX) this.pin(hit.person.id);
    }, { signal });
  }

  /** One pointer turns the view, two move it closer. @param {PointerEvent} event */
  drag({ pointerId, clientX: x, clientY: y }) {
    const before = this.pointers.get(pointerId);
    if (!before) return;
    const [right, down] = [x - before.x, y - before.y];
    const other = [...this.pointers].find(([id]) => id !== pointerId)?.[1];
    this.pointers.set(pointerId, { x, y });
    this.movedPx += Math.hypot(right, down);
    if (other) {
      const apart = Math.hypot(before.x - other.x, before.y - other.y);
      this.zoom(Math.hypot(x - other.x, y - other.y) / Math.max(apart, 1));
    } else if (this.movedPx >= TAP_PX) {
      this.orbit(right, down);
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const { key, target } = event;
    if (event.ctrlKey || event.altKey || event.metaKey || target instanceof HTMLInputElement) {
      return;
    }
    /** @type {Record<string, () => void>} */
    const keys = {
      "+": () => this.zoom(ZOOM_PER_STEP),
      "-": () => this.zoom(1 / ZOOM_PER_STEP),
      ArrowLeft: () => this.orbit(KEY_STEP_PX, 0),
      ArrowRight: () => this.orbit(-KEY_STEP_PX, 0),
      ArrowUp: () => this.orbit(0, KEY_STEP_PX),
      ArrowDown: () => this.orbit(0, -KEY_STEP_PX),
    };
    for (const button of document.querySelectorAll("[aria-keyshortcuts]")) {
      keys[button.getAttribute("aria-keyshortcuts") ?? ""] = () => element(button.id).click();
    }
    this.shown.forEach(({ person }, index) => (keys[index + 1] = () => this.pin(person.id)));
    if (!keys[key]) return;
    event.preventDefault();
    keys[key]();
  }
}
