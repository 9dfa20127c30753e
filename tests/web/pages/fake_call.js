// Stands in for call.js: people whose faces the test has made beforehand, 30 a second, in a loop.
import { openAvatar } from "./avatar.js";
import { loadFloats } from "./pages.js";

const FRAME = 262; // latent, rotation, translation

export class Call extends EventTarget {
  members = new Map();
  self = null;
  status = { state: "joining", reason: "", code: "" };
  voice = {
    needsTap: false, isMuted: true, note: "",
    start: async () => {},
    speak: async () => this.voice.mute(false),
    mute: (isMuted) => { this.voice.isMuted = isMuted; this.say("voice"); },
  };

  get participants() {
    return [...this.members.values()];
  }

  say(type) {
    this.dispatchEvent(new Event(type));
  }

  async join() {
    const people = await (await fetch("people.json")).json();
    this.status.state = "joined";
    this.say("status");
    const avatars = new Map();
    for (const [index, { avatar, isSelf, ...more }] of people.entries()) {
      const faces = avatar ? await loadFloats(`${index}.faces`) : null;
      const person = {
        id: String(index), avatar: null, state: avatar ? "avatar is loading" : "", isSpeaking: index === 0, ...more,
        want: () => {},
        faceAt: (now) => {
          if (!faces) return null;
          const at = FRAME * (Math.floor((globalThis.frozenAt ?? now) * 30) % (faces.length / FRAME));
          return { values: faces.slice(at, at + FRAME), status: "live" };
        },
      };
      if (isSelf) this.self = person;
      else this.members.set(person.id, person);
      if (avatar && !avatars.has(avatar)) {
        avatars.set(avatar, fetch(`${avatar}.pica`).then((answer) => answer.arrayBuffer()).then((bytes) => openAvatar(bytes)));
      }
      avatars.get(avatar)?.then(
        (found) => Object.assign(person, { avatar: found, state: "" }),
        (error) => Object.assign(person, { state: error.message }),
      ).then(() => this.say("people"));
    }
    this.say("people");
  }

  leave() {
    this.status.state = "ended";
    this.say("status");
  }
}
