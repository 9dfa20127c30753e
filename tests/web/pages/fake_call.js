// Stands in for call.js: people whose faces the test has made beforehand, 30 a second, in a loop.
import { loadFloats } from "./pages.js";

const FRAME = 262; // latent, rotation, translation

export class Call extends EventTarget {
  constructor({ openAvatar }) {
    super();
    this._openAvatar = openAvatar;
    this.participants = [];
    this.self = null;
    this.status = { state: "joining", reason: "", room: "demo", name: "", code: "", isEncrypted: false };
    this.voice = {
      needsTap: false, isMuted: true, note: "",
      start: async () => {},
      speak: async () => { this.voice.isMuted = false; this.dispatchEvent(new Event("voice")); },
      mute: (isMuted) => { this.voice.isMuted = isMuted; this.dispatchEvent(new Event("voice")); },
      playOn: async () => {},
    };
  }

  async join({ name }) {
    this.status.name = name;
    const people = await (await fetch("people.json")).json();
    this.status.state = "joined";
    this.dispatchEvent(new Event("status"));
    const avatars = new Map();
    for (const [index, { name, avatar, isSelf, ...more }] of people.entries()) {
      const faces = avatar ? await loadFloats(`${index}.faces`) : null;
      const person = {
        id: String(index), name, place: index, avatarId: avatar ?? "none", avatar: null, note: "", isAway: false,
        isVoiceMuted: false, isFaceMuted: false, isSpeaking: index === 0, isRecording: false, seal: "", gain: 1, ...more,
        want: () => {},
        faceAt: (now) => {
          if (!faces) return null;
          const at = FRAME * (Math.floor((globalThis.frozenAt ?? now) * 30) % (faces.length / FRAME));
          return {
            latent: faces.slice(at, at + 256), rotation: faces.slice(at + 256, at + 259),
            translation: faces.slice(at + 259, at + 262), status: "live", capturedUs: 0,
          };
        },
      };
      if (isSelf) this.self = person;
      else this.participants.push(person);
      if (avatar && !avatars.has(avatar)) {
        avatars.set(avatar, fetch(`${avatar}.pica`).then((answer) => answer.arrayBuffer()).then((bytes) => this._openAvatar(bytes, avatar)));
      }
      avatars.get(avatar)?.then(
        (found) => { person.avatar = found; this.dispatchEvent(new Event("people")); },
        (error) => { person.note = error.message; this.dispatchEvent(new Event("people")); },
      );
    }
    this.dispatchEvent(new Event("people"));
  }

  leave() {
    this.status.state = "ended";
    this.dispatchEvent(new Event("status"));
  }
}
