/**
 * The page: from a link to a call. A link is `https://RELAY/ROOM#token=…&secret=…`; what stands
 * behind `#` never leaves the browser but in the join. `?tile=NAME&background=transparent` or
 * `green` shows one participant alone, for a browser source of OBS.
 */

import { Call } from "./call.js";
import { Picture } from "./scene.js";
import { CallView, element } from "./ui.js";
import { said } from "./wire.js";

const query = new URLSearchParams(location.search);
const fragment = new URLSearchParams(location.hash.slice(1));
const tile = query.get("tile");
const room = decodeURIComponent(location.pathname.split("/").pop() ?? "")
  || fragment.get("room") || "";
const calm = matchMedia("(prefers-reduced-motion: reduce)");
/** @param {string} name Of a file that the relay made beside the modules. */
const load = async (name) => (await fetch(new URL(name, import.meta.url))).json();
/** Only one, for a browser lends out few contexts; made while the form is filled in. */
const picture = load("shaders.json")
  .then((texts) => new Picture(element("picture"), texts, tile !== null));

/** One clear line, in the form. @param {unknown} problem */
function complain(problem) {
  element("problem").textContent = said(problem);
  element("call").hidden = true;
  element("join").hidden = false;
  element("begin").focus();
}

/** @param {string} name @param {string} avatarId */
async function enter(name, avatarId) {
  const call = new Call(new URL(".", location.href));
  call.join({ room, token: fragment.get("token") ?? "", secret: fragment.get("secret")
    ?? "", name, avatarId });
  element("join").hidden = true;
  element("call").hidden = false;
  const drawn = await picture.catch((error) => {
    call.leave();
    throw error;
  });
  const view = new CallView(call, drawn);
  if (tile === null) void call.voice.start();
  const frame = () => {
    if (call.status.state === "ended") {
      view.close();
      complain(call.status.reason || "You left the call.");
      return;
    }
    const people = call.participants.filter((person) => tile === null || person.name === tile);
    view.wanted.isCalm = calm.matches;
    const wanted = tile === null ? view.wanted
      : { ...view.wanted, layout: /** @type {const} */ ("grid"), self: null, free: 0 };
    try {
      const labels = drawn.draw(people, wanted, performance.now() / 1000);
      if (labels && tile === null) view.place(labels);
      requestAnimationFrame(frame);
    } catch (error) {
      call.leave();
      view.close();
      complain(error);
    }
  };
  frame();
}

/** The name of last time, where the browser keeps one. @param {string} name To be kept. */
function remembered(name = "") {
  try {
    if (name) localStorage.setItem("name", name);
    return localStorage.getItem("name") ?? "";
  } catch {
    return "";
  }
}

function begin() {
  element("old").remove();
  element("room").textContent = room ? `Join ${room}` : "Join a call";
  document.title = room ? `${room} · PiCA` : "PiCA";
  document.body.classList.toggle("tile", tile !== null);
  document.body.classList.toggle("green", tile !== null && query.get("background") === "green");
  if (tile !== null) {
    enter(query.get("name") ?? `Camera of ${tile}`.slice(0, 64), "").catch(complain);
    return;
  }
  /** @type {HTMLInputElement} */
  const name = element("name");
  /** @type {HTMLSelectElement} */
  const avatar = element("avatar");
  name.value = remembered();
  element("join").hidden = false;
  picture.catch(complain);
  // One may join without.
  load("avatars.json").then((ids) => {
    avatar.append(...Object.entries(ids).map(([text, id]) => new Option(text, id)));
  }, () => {});
  /** @type {HTMLInputElement} */
  const own = element("file");
  element("join").addEventListener("submit", async (event) => {
    event.preventDefault();
    remembered(name.value);
    element("problem").textContent = "";
    /** @type {HTMLButtonElement} */ (element("begin")).disabled = true;
    try {
      const [file] = own.files ?? [];
      const id = file ? await (await import("./upload.js")).giveAvatar(file,
        new URL(".", location.href), fragment.get("token") ?? "") : avatar.value;
      await enter(name.value.trim(), id);
    } catch (error) {
      complain(error);
    } finally {
      /** @type {HTMLButtonElement} */ (element("begin")).disabled = false;
    }
  });
}

begin();
