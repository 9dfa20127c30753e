"""End-to-end encryption of one link: frames out, events in, key messages between. Pure.

Every peer has a random *sender key*, whose generation counts up. It is given to every other peer
that proves to know the room secret and describes itself as the relay does, wrapped for it alone. It
changes when a member leaves who was given it, and when one comes, unless it has sealed nothing
or is younger than `YOUNG_KEY_S`. Messages leave before the frames that need them, and arrive in
that order, so a new key is used at once.

The relay says who comes and goes, and may lie and repeat. So whenever it says that a member came or
came back, we forget that peer and draw a *challenge* for it, and take its key only from a message
that echoes the challenge. A peer that sees a new challenge gives its key from the counter on that
it has reached: what it sealed earlier does not open, on this connection or another one. The first
public key that comes stays until a message with another one echoes the challenge; then the peer is
taken for one that came just now.

What cannot be opened is dropped and counted; no plain frame is ever taken. Everything is bounded:
peers by the session, their keys by `KEY_IDS`, messages by a rate below the relay's limit.
"""

import os
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from pica_client import errors
from pica_client.e2ee import frames, peer_keys
from pica_client.e2ee.peer_keys import FIRST_WAIT_S, KEY_IDS, PeerKeys
from pica_client.e2ee.secret import RandomBytes, RoomSecret, SealState, SealStatus
from pica_client.tracks import FACE_TRACK
from pica_protocol import messages
from pica_protocol.frames import Frame, clear_header
from pica_protocol.session import ClientEvent, Closed

FRAMES_PER_KEY: Final = 65_536
"""Then a key changes: counters stay within two bytes. 36 minutes at 30 frames a second."""
YOUNG_KEY_S: Final = 1.0
"""A newcomer may open what was sealed so long before (chosen: a full room coming at once costs one
change of keys a second)."""
MESSAGES_PER_S: Final = 12.0
MESSAGES_AT_ONCE: Final = 96.0
"""How many messages go out; a little below what a relay passes on (16 a second, 128 at once)."""


@dataclass(kw_only=True, slots=True)
class SealCounters:
    """What was sealed, opened and refused since the guard was made.

    Frames are unreadable if their key is not here yet or was replaced, and forged if they were
    changed on their way or are not sealed at all.
    """

    sealed: int = 0
    opened: int = 0
    unreadable: int = 0
    replayed: int = 0
    forged: int = 0
    messages_refused: int = 0
    key_changes: int = 0


@dataclass(slots=True)
class _OwnKey:
    """The key that we seal with."""

    base_key: bytes
    key: frames.FrameKey
    made_s: float
    counter: int = 0


class Guard:
    """Stands between the session of a `transport.link.Link` and everybody else on this side.

    The link asks it before a frame goes out and before an event is handed on, and carries its
    whispers. One for each link.

    Attributes:
        status: Which peers are verified, and the code to read aloud, as of when we were last in
            the room; a new object at each change, so any thread may read it.
    """

    def __init__(self, secret: RoomSecret, *, random_bytes: RandomBytes = os.urandom) -> None:
        """Start outside any room."""
        self.counters = SealCounters()
        self.status = SealStatus()
        self._secret = secret
        self._random_bytes = random_bytes
        self._peers: dict[str, PeerKeys] = {}
        self._own: _OwnKey | None = None
        self._generation = 0
        self._now = 0.0
        self._budget, self._budget_s = MESSAGES_AT_ONCE, 0.0

    def stats(self) -> dict[str, Any]:
        """Return the counters and the state of the keys, for people and reports."""
        return {
            **asdict(self.counters),
            "members": len(self.status.verified),
            "code": self.status.code,
            "peers": {who: state.value for who, state in self.status.peers.items()},
        }

    def begin(self, room: str, name: str) -> None:
        """Bind keys to the room that we are about to join, and to our name in it."""
        self._room, self._name = room, name
        self._code_key = peer_keys.room_key(self._secret, room, b"code")
        self._pair_salt = peer_keys.room_key(self._secret, room, b"pair")

    def seal(self, frame: Frame) -> bytes:
        """Return the payload to send instead of the frame's own, once its header is final.

        Raises:
            SealError: We are in no room.
        """
        if self._own is None:
            raise errors.SealError("there is no key to seal with: not in a room")
        if self._own.counter >= FRAMES_PER_KEY:
            self._change_key()
        own, payload = self._own, frame.payload
        # A voice is not padded: where it is sealed it is coded at a constant bit rate.
        if self._kinds.get(frame.stream) == FACE_TRACK:
            payload = frames.pad(payload)
        sealed = frames.seal(payload, clear_header(frame), own.key, own.counter)
        own.counter += 1
        self.counters.sealed += 1
        return sealed

    def receive_event(self, event: ClientEvent, now: float) -> list[ClientEvent]:
        """Take an event of the session and return what the owner of the link gets instead.

        Whispers end here and frames come out plain.
        """
        self._now = now
        passed: list[ClientEvent] = [event]
        match event:
            case Frame():
                return self._open(event)
            case messages.Whisper(peer_id=peer_id, data=data):
                try:
                    self._receive_key_message(peer_id, data)
                except errors.SealError:
                    self.counters.messages_refused += 1
                passed = []
            case messages.Joined():
                self._enter(event)
            case messages.PeerJoined(peer=peer):
                self._add(peer)
            case messages.PeerAway(peer_id=peer_id, is_away=False) if peer_id in self._peers:
                self._add(self._peers[peer_id].peer)
            case messages.PeerLeft(peer_id=peer_id):
                self._remove(peer_id)
            case Closed():
                self._peers.clear()
                self._own = None
        self._update_status()
        return passed

    def messages_to_send(self, now: float) -> list[tuple[str, bytes]]:
        """Take the whispers that must go out now, peer ids and data: before every frame that was
        sealed before this call."""
        self._now = now
        refill = max(now - self._budget_s, 0.0) * MESSAGES_PER_S
        self._budget, self._budget_s = min(MESSAGES_AT_ONCE, self._budget + refill), now
        due = [(p.due_s, p) for p in self._peers.values() if p.due_s is not None and p.due_s <= now]
        ready = []
        # A timer that fires just in time finds a budget of one, give or take rounding.
        for _, peer in sorted(due, key=lambda item: item[0])[: int(self._budget + 1e-6)]:
            ready.append((peer.peer.peer_id, self._key_message(peer)))
            peer.note_sent(self._generation, now)
        self._budget -= len(ready)
        if ready:
            self._update_status()
        return ready

    def next_timer(self) -> float | None:
        """Return when `messages_to_send` has something to say, or None."""
        due = [peer.due_s for peer in self._peers.values() if peer.due_s is not None]
        refilled_s = self._budget_s + max(1 - self._budget, 0) / MESSAGES_PER_S
        return max(min(due), refilled_s) if due else None

    # Who is in the room

    def _enter(self, joined: messages.Joined) -> None:
        """Begin a stay in a room, with keys that are used nowhere else."""
        self._peers.clear()
        self._streams: dict[int, tuple[str, str]] = {}  # owner and kind of the others' streams
        self._own_id = joined.peer_id
        self._kinds = {track.stream: track.kind for track in joined.tracks}
        self._description = peer_keys.describe(self._room, self._name, joined.tracks)
        private_bytes = self._random_bytes(peer_keys.PUBLIC_KEY_BYTES)
        self._private = X25519PrivateKey.from_private_bytes(private_bytes)
        self._public_key = self._private.public_key().public_bytes_raw()
        self._change_key()
        for peer in joined.peers:
            self._add(peer)

    def _add(self, peer: messages.Peer) -> PeerKeys:
        """Take a member who came in, or came back: it has to prove itself again."""
        self._remove(peer.peer_id)
        added = self._peers[peer.peer_id] = PeerKeys(
            peer,
            description=peer_keys.describe(self._room, peer.name, peer.tracks),
            challenge=self._random_bytes(peer_keys.CHALLENGE_BYTES),
            came_s=self._now,
            due_s=self._now,
        )
        self._streams |= {track.stream: (peer.peer_id, track.kind) for track in peer.tracks}
        return added

    def _remove(self, peer_id: str) -> None:
        """Take a departure: the key that was given to that member seals no longer."""
        peer = self._peers.pop(peer_id, None)
        if peer is not None and peer.given == self._generation:
            self._change_key()

    def _update_status(self) -> None:
        if self._own is None:
            return
        given = [(p.public_key, p.description) for p in self._peers.values() if p.given]
        self.status = SealStatus(
            room=self._room,
            peers={peer_id: peer.state_at(self._now) for peer_id, peer in self._peers.items()},
            members=((self._public_key, self._description), *given),
        )

    # Keys

    def _change_key(self) -> None:
        self._generation += 1
        self.counters.key_changes += 1
        base_key = self._random_bytes(frames.BASE_KEY_BYTES)
        key = frames.derive_key(base_key, self._generation % KEY_IDS)
        self._own = _OwnKey(base_key, key, self._now)
        for peer in self._peers.values():
            if peer.public_key:
                peer.first = 0
                peer.say_more(self._now)

    def _key_message(self, peer: PeerKeys) -> bytes:
        assert self._own is not None  # there are peers in a room only
        peer.given = self._generation if peer.public_key else 0
        message = peer_keys.KeyMessage(
            wants_answer=peer.wait_s > FIRST_WAIT_S,
            public_key=self._public_key,
            challenge=peer.challenge,
            echo=peer.its_challenge,
            acknowledged=peer.newest,
            generation=peer.given,
            first=peer.first,
            description=self._description,
        )
        way, base_key = (self._own_id, peer.peer.peer_id), self._own.base_key
        return peer_keys.encode(message, self._code_key, way, peer.pair_key, base_key)

    def _receive_key_message(self, peer_id: str, data: bytes) -> None:
        """Take what a peer whispers."""
        peer, way = self._peers.get(peer_id), (peer_id, self._own_id)
        if peer is None:
            raise errors.SealError("not from anybody in the room")
        message = peer_keys.decode(data, self._code_key, way)
        is_relabelled = message is not None and message.description != peer.description
        if not peer.is_verified:
            peer.state = SealState.RELABELLED if is_relabelled else SealState.WAITING
        if message is None and not peer.is_verified:
            peer.state = SealState.SECRET_DIFFERS
        if message is None or is_relabelled:
            raise errors.SealError("not by this peer with the secret of this room")
        is_live = message.echo == peer.challenge
        if message.public_key != peer.public_key and (is_live or not peer.public_key):
            if peer.public_key:  # it began again, and the relay did not say so
                peer, is_live = self._add(peer.peer), False
            self._meet(peer, message.public_key)
        assert self._own is not None  # there are peers in a room only
        if message.challenge != peer.its_challenge:
            peer.its_challenge = message.challenge
            peer.first, peer.acknowledged = self._own.counter, 0
            peer.say_more(self._now)
        if is_live:
            acknowledged = min(message.acknowledged, self._generation)
            peer.acknowledged = max(peer.acknowledged, acknowledged)
            if message.generation > peer.newest:
                base_key = peer_keys.unwrap(data, way, peer.pair_key)
                peer.take_key(message.generation, base_key, message.first, self._now)
        if message.wants_answer:
            peer.due_s = self._now
        elif peer.is_content(self._generation) and (peer.due_s or 0.0) > self._now:
            peer.due_s = None

    def _meet(self, peer: PeerKeys, public_key: bytes) -> None:
        """Learn a public key: from now on the peer can be given ours."""
        if public_key in {self._public_key, *(each.public_key for each in self._peers.values())}:
            raise errors.SealError("a public key of another member of the room")
        peer.pair_key = peer_keys.agree(self._private, public_key, self._pair_salt)
        peer.public_key = public_key
        assert self._own is not None  # there are peers in a room only
        if self._own.counter and self._now - self._own.made_s >= YOUNG_KEY_S:
            self._change_key()

    # Frames

    def _open(self, frame: Frame) -> list[ClientEvent]:
        counters = self.counters
        owner, kind = self._streams.get(frame.stream, ("", ""))
        keys = self._peers[owner].keys if owner in self._peers else {}
        try:
            key_id, counter, _ = frames.decode_header(frame.payload)
            opening = keys.get(key_id)
            if opening is None or opening.expires_s <= self._now:
                counters.unreadable += 1
                return []
            if not opening.window.is_new(counter):
                counters.replayed += 1
                return []
            payload = frames.open_(frame.payload, clear_header(frame), opening.key)
            if kind == FACE_TRACK:
                payload = frames.unpad(payload)
        except errors.SealError:
            counters.forged += 1
            return []
        opening.window.mark(counter)
        counters.opened += 1
        return [replace(frame, payload=payload)]
