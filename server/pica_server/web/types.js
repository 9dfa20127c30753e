/**
 * What the halves of the page tell each other: the call (wire, stream, encryption, playout, voice)
 * and the picture (avatar files, decoder, drawing, seats). Types alone; nothing is run.
 *
 * Times are in seconds of `performance.now() / 1000` and are called `now`, as in the Python client.
 * The page is a relay's package data, so that every relay that can be installed can serve it; it is
 * written for a browser and imports nothing but its own modules.
 *
 * @module
 */

/**
 * How fresh a face is: as `FaceStatus` of the Python client.
 *
 * @typedef {"waiting" | "live" | "concealed" | "stale" | "away"} FaceStatus
 */

/**
 * A face to be drawn.
 *
 * @typedef {object} Face
 * @property {Float32Array} latent 256 values; do not write into it.
 * @property {Float32Array} rotation
 * @property {Float32Array} translation
 * @property {FaceStatus} status
 */

/**
 * What the call needs of an avatar file: its tensors, by name.
 *
 * @typedef {object} AvatarFile
 * @property {string} id SHA-256 of its bytes, in hexadecimal.
 * @property {(name: string) => ArrayLike<number>} integers A tensor as it is stored.
 * @property {(name: string) => Float32Array} floats Any tensor, as floats.
 */

/**
 * Reads the bytes of an avatar file, which have been checked against the id, and throws an `Error`
 * with one clear line if they are none, or too new. `avatar.js` exports it as `openAvatar`.
 *
 * @template {AvatarFile} T
 * @callback OpenAvatar
 * @param {ArrayBuffer} bytes
 * @param {string} id
 * @returns {T}
 */

/**
 * Another member of the room. Its properties change in place; `Call` says `"people"` when they do.
 *
 * @template {AvatarFile} [T=AvatarFile]
 * @typedef {object} Participant
 * @property {string} id Unique in the call.
 * @property {string} name To be shown: with a number where two have the same.
 * @property {number} place Rises with the order of coming, and is kept when a participant comes back.
 * @property {string} avatarId SHA-256 of the avatar file; empty: sends no face.
 * @property {T | null} avatar Once it is here, checked and read.
 * @property {string} note Why there is no face, or what is wrong, in a few words; else empty.
 * @property {boolean} isAway Whether the connection is lost and may come back.
 * @property {boolean} isVoiceMuted False for those who send no voice.
 * @property {boolean} isFaceMuted
 * @property {boolean} isSpeaking
 * @property {boolean} isRecording
 * @property {"" | "waiting" | "verified" | "plain" | "secret differs" | "relabelled"} seal State of
 *     the encryption; empty where the call is not encrypted.
 * @property {number} gain Volume for us alone, 0 to 2; may be set.
 * @property {(now: number) => Face | null} faceAt The face to be shown now; null before the first.
 *     To be asked once for each picture of the display, also for heads that are hidden.
 * @property {(every: 0 | 1 | 2 | 4) => void} want Say which share of the stream is needed: all, a
 *     half, a quarter, none. It may be called as often as wished: the relay is told late of less.
 */

/**
 * @typedef {object} CallStatus
 * @property {"joining" | "joined" | "reconnecting" | "ended"} state
 * @property {string} reason Why it is not joined, in one line for people; else empty.
 * @property {string} room
 * @property {string} name Our own name, as the others see it.
 * @property {string} code Thirty digits to read aloud; empty without encryption.
 * @property {boolean} isEncrypted
 */

/**
 * The voices of a call, in `voice.js`. All that must wait for a person's tap is here.
 *
 * @typedef {object} Voice
 * @property {boolean} needsTap Whether the browser plays nothing before a tap.
 * @property {() => Promise<void>} start To be called by a tap.
 * @property {boolean} isMuted Whether the microphone is off, or there is none.
 * @property {string} note What is wrong with microphone or loudspeaker, in one line; else empty.
 * @property {(deviceId?: string) => Promise<void>} speak Open a microphone and speak.
 * @property {(isMuted: boolean) => void} mute
 * @property {(deviceId: string) => Promise<void>} playOn Choose a loudspeaker.
 */

/**
 * A call; `call.js` exports the class `Call`, an `EventTarget` with these events:
 *
 * - `people`: a participant came, went or changed; look at `participants` again.
 * - `status`: look at `status` again.
 * - `voice`: look at `voice` again.
 *
 * `new Call({openAvatar, base})`, with `base` the URL of the page's folder, then `join` once.
 *
 * @template {AvatarFile} [T=AvatarFile]
 * @typedef {object} CallSurface
 * @property {readonly Participant<T>[]} participants The others, in the order of coming.
 * @property {Participant<T> | null} self Our own face as the others get it; null: we send none.
 * @property {CallStatus} status
 * @property {Voice} voice
 * @property {(where: {room: string, token: string, secret: string, name: string,
 *     avatarId?: string}) => void} join With an avatar we send a face, which the voice moves.
 * @property {() => void} leave
 */

export {};
