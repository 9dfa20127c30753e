"""Who has which key of whom: the state machine that makes, gives, takes and drops keys. Pure.

Every peer that sends has a *sender key*, random, with a generation that counts up. Every other
peer that proves to know the room secret is given it, wrapped for that peer alone. The rules:

- Whoever is new to us, or has not said that it has our key, is sent a note, again and again with
  growing waits, until it has.
- When somebody who was given our key leaves, we make a new one at once, before the next frame.
- When somebody comes, likewise, so that nobody opens what was sent before; except that a key that
  has sealed nothing, or is younger than `YOUNG_KEY_S`, is not changed for this.
- A key seals `FRAMES_PER_KEY` frames, then comes the next.
- A key of theirs that was followed by a newer one opens for `LATE_FRAMES_S` more.

Notes leave before the frames that need them: on one connection they arrive in that order. So a new
key is used at once, and nobody misses a frame unless a note is lost.

What is known of a peer grows in steps: nothing, its public key (a note came), that it knows ours
(the note echoed it). The first public key that comes stays, until a note with another one echoes
our present key: such a note cannot be an old one that the relay repeats. A public key that was
given up never comes back, so no key is ever taken twice, with its counters forgotten.

Everything is bounded: peers by the room, keys of a peer by `KEYS_PER_PEER`, notes by a rate below
the relay's own limit.
"""

from dataclasses import dataclass, field
from typing import Final

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from pica_client.e2ee.errors import NoteError, SealError
from pica_client.e2ee.frames import FrameKey, derive_key
from pica_client.e2ee.notes import (
    BASE_KEY_BYTES,
    MAX_GENERATION,
    NOBODY,
    PUBLIC_KEY_BYTES,
    Note,
    RoomKeys,
    Way,
    WrapKey,
    agree,
    decode_note,
    encode_note,
    fingerprint,
)
from pica_client.e2ee.replay import ReplayWindow
from pica_client.e2ee.secret import RandomBytes, RoomSecret
from pica_client.e2ee.suites import AES_128_GCM_SHA256_128, SUITES, Suite
from pica_protocol.limits import MAX_PEERS
from pica_protocol.messages import Joined

KEY_IDS: Final = 8
"""Key ids go round: so many fit the config byte of a sealed payload, and cost nothing."""
KEYS_PER_PEER: Final = 4
"""Keys of one peer that we hold; half of `KEY_IDS`, so no two share an id."""
FORMER_KEYS: Final = 16
"""Public keys of one peer in one stay; a peer that comes back unseen needs another (chosen)."""
FRAMES_PER_KEY: Final = 65_536
"""Then a key changes: counters stay within two bytes. 36 minutes at 30 frames a second."""
YOUNG_KEY_S: Final = 1.0
"""Whoever comes may open what was sealed so long before (chosen: a full room coming at once costs
one change of keys a second)."""
LATE_FRAMES_S: Final = 2.0
"""How long a key that was replaced still opens what is under way (chosen: longer than a relay lets
a slow reader lag)."""
FIRST_WAIT_S: Final = 0.25
LONGEST_WAIT_S: Final = 8.0
"""Between two notes to a peer that does not answer; doubles from the first to the longest."""
ANSWER_WAIT_S: Final = 0.1
"""Least time between two notes to a peer that has nothing new to say."""
ASK_WAIT_S: Final = 1.0
"""Least time between two notes that ask for a missing key."""
NOTES_PER_S: Final = 12.0
NOTES_AT_ONCE: Final = 96.0
"""How many notes go out; a little below what a relay passes on (16 a second, 128 at once)."""

_ONE_NOTE = 1 - 1e-6
"""A timer that fires just in time finds a budget of one, give or take rounding."""


@dataclass(slots=True)
class OpeningKey:
    """A key of somebody else, with what it has opened."""

    generation: int
    key: FrameKey
    window: ReplayWindow = field(default_factory=ReplayWindow)
    expires_s: float | None = None
    """When it is forgotten; None while it is the newest."""


@dataclass(slots=True)
class _OwnKey:
    generation: int
    base_key: bytes
    key: FrameKey
    made_s: float
    counter: int = 0


@dataclass(slots=True)
class _Peer:
    due_s: float | None
    """When it gets its next note; None: it needs none."""
    public_key: bytes | None = None
    former_keys: set[bytes] = field(default_factory=set)
    """Public keys it had before: they never come back."""
    wrap: WrapKey | None = None
    unwrap: WrapKey | None = None
    knows_us: bool = False
    given: int = 0
    """Newest generation of our key that a note took to it."""
    acknowledged: int = 0
    """Newest generation of our key that it has."""
    keys: dict[int, OpeningKey] = field(default_factory=dict)
    """Keys by key id, oldest first."""
    newest: int = 0
    sent_s: float = float("-inf")
    wait_s: float = FIRST_WAIT_S
    is_repeat: bool = False
    """Whether its next note says nothing new: then it must ask for an answer."""


class KeyExchange:
    """Our side of all key exchanges in a room.

    Attributes:
        key_changes: How often we made a key.
        has_newcomer: Somebody can open our frames from now on who could not before: time for a
            keyframe. Whoever sees to that resets it.
    """

    def __init__(
        self,
        secret: RoomSecret,
        *,
        random_bytes: RandomBytes,
        suite: Suite = AES_128_GCM_SHA256_128,
    ) -> None:
        """Start outside any room.

        Args:
            secret: What the members of the room share.
            random_bytes: Where keys come from.
            suite: What we seal with; we open what any suite we know has sealed.
        """
        self.key_changes = 0
        self.has_newcomer = False
        self._secret = secret
        self._random_bytes = random_bytes
        self._suite = suite
        self._peers: dict[str, _Peer] = {}
        self._own: _OwnKey | None = None
        self._generation = 0
        self._now = 0.0
        self._budget = NOTES_AT_ONCE
        self._budget_s = 0.0

    # What happened

    def receive_joined(self, joined: Joined, now: float) -> None:
        """We are in a room: begin anew, with keys that are used nowhere else."""
        self.receive_closed(now)
        self._own_id = joined.peer_id
        self._room_keys = RoomKeys.of(self._secret, joined.room)
        self._private = X25519PrivateKey.from_private_bytes(self._random_bytes(PUBLIC_KEY_BYTES))
        self._public_key = self._private.public_key().public_bytes_raw()
        if joined.tracks:
            self._change_key()
        for peer in joined.peers:
            self.receive_peer_joined(peer.peer_id, now)

    def receive_peer_joined(self, peer_id: str, now: float) -> None:
        """Somebody came in."""
        self._now = now
        if len(self._peers) < MAX_PEERS:
            self._peers.setdefault(peer_id, _Peer(due_s=now))

    def receive_peer_left(self, peer_id: str, now: float) -> None:
        """Somebody went: the key that was theirs to open with is no longer ours to seal with."""
        self._now = now
        peer = self._peers.pop(peer_id, None)
        if peer is not None and self._own is not None and peer.given == self._own.generation:
            self._change_key()

    def receive_closed(self, now: float) -> None:
        """We are in no room any more: every key is forgotten."""
        self._now = now
        self._peers.clear()
        self._own = None
        self.has_newcomer = False

    def receive_note(self, peer_id: str, data: bytes, now: float) -> None:
        """Take what a peer whispers.

        Raises:
            NoteError: It is no note, or not from a member, or the key in it is not for us. What it
                proved until then holds.
        """
        self._now = now
        peer = self._peers.get(peer_id)
        if peer is None:
            raise NoteError("a note from nobody in the room")
        note = decode_note(data, self._room_keys.note_key, Way(peer_id, self._own_id))
        echoes_us = note.echo == fingerprint(self._public_key)
        if note.public_key in peer.former_keys:
            raise NoteError("a public key that was given up")
        if note.public_key != peer.public_key:
            if peer.public_key is None or echoes_us:
                self._meet(peer, note.public_key)
            else:
                note = Note(public_key=note.public_key, wants_answer=True)  # let it prove itself
        if echoes_us:
            peer.knows_us = True
            peer.acknowledged = max(peer.acknowledged, min(note.acknowledged, self._generation))
            if note.wrapped_key and note.generation > peer.newest:
                self._take_key(peer, note)
        if peer.due_s is None or peer.due_s > now:
            if note.wants_answer:
                answer_s = max(now, peer.sent_s + ANSWER_WAIT_S)
                peer.due_s = answer_s if peer.due_s is None else min(peer.due_s, answer_s)
            elif self._is_content(peer):
                peer.due_s = None

    def receive_unreadable(self, peer_id: str, now: float) -> None:
        """A frame came for which we have no key: ask for it, but not for each."""
        self._now = now
        peer = self._peers.get(peer_id)
        if peer is None or peer.public_key is None:
            return  # it has not shown that it has the secret, and is sent notes anyway
        ask_s = max(now, peer.sent_s + ASK_WAIT_S)
        if peer.due_s is None or peer.due_s > ask_s:
            peer.due_s = ask_s
            peer.is_repeat = True

    # What must go out, and when

    def messages_to_send(self, now: float) -> list[tuple[str, bytes]]:
        """Take the notes that must go out now, each with the id of its receiver."""
        self._now = now
        elapsed_s = max(now - self._budget_s, 0.0)
        self._budget = min(NOTES_AT_ONCE, self._budget + elapsed_s * NOTES_PER_S)
        self._budget_s = now
        due = [
            (peer.due_s, peer_id, peer)
            for peer_id, peer in self._peers.items()
            if peer.due_s is not None and peer.due_s <= now
        ]
        notes = []
        for _, peer_id, peer in sorted(due, key=lambda item: item[0]):
            if self._budget < _ONE_NOTE:
                break
            self._budget -= 1
            way = Way(self._own_id, peer_id)
            notes.append((peer_id, encode_note(self._note(peer), self._room_keys.note_key, way)))
            peer.sent_s = now
            if self._is_content(peer):
                peer.due_s, peer.is_repeat = None, False
            else:
                peer.due_s, peer.is_repeat = now + peer.wait_s, True
                peer.wait_s = min(2 * peer.wait_s, LONGEST_WAIT_S)
        return notes

    def next_timer(self) -> float | None:
        """Return when `handle_timer` and `messages_to_send` have something to do, or None."""
        times = [
            opening.expires_s
            for peer in self._peers.values()
            for opening in peer.keys.values()
            if opening.expires_s is not None
        ]
        due = [peer.due_s for peer in self._peers.values() if peer.due_s is not None]
        if due:
            refilled_s = self._budget_s + max(1 - self._budget, 0) / NOTES_PER_S
            times.append(max(min(due), refilled_s))
        return min(times, default=None)

    def handle_timer(self, now: float) -> None:
        """Forget keys of others whose time is over."""
        self._now = now
        for peer in self._peers.values():
            for key_id, opening in list(peer.keys.items()):
                if opening.expires_s is not None and opening.expires_s <= now:
                    del peer.keys[key_id]

    # The keys themselves

    def next_counter(self) -> tuple[FrameKey, int]:
        """Return the key and the counter for one frame of ours; never the same pair twice.

        Raises:
            SealError: We are in no room, or said at joining that we would send nothing.
        """
        if self._own is not None and self._own.counter >= FRAMES_PER_KEY:
            self._change_key()
        own = self._own
        if own is None:
            raise SealError("there is no key to seal with: not in a room, or nothing to publish")
        counter = own.counter
        own.counter += 1
        return own.key, counter

    def opening_key(self, peer_id: str, key_id: int, now: float) -> OpeningKey | None:
        """Return a peer's key, if we have it and it still opens."""
        peer = self._peers.get(peer_id)
        opening = None if peer is None else peer.keys.get(key_id)
        if opening is None or (opening.expires_s is not None and opening.expires_s <= now):
            return None
        return opening

    @property
    def members(self) -> frozenset[str]:
        """The ids of those in the room who have proven to know the secret."""
        return frozenset(
            peer_id for peer_id, peer in self._peers.items() if peer.public_key is not None
        )

    def _meet(self, peer: _Peer, public_key: bytes) -> None:
        """Learn a public key: from now on the peer can be given ours."""
        if len(peer.former_keys) >= FORMER_KEYS:
            raise NoteError(f"more than {FORMER_KEYS} public keys in one stay")
        wraps = agree(self._private, self._public_key, public_key, self._room_keys.pair_salt)
        if peer.public_key is not None:
            peer.former_keys.add(peer.public_key)
        peer.public_key = public_key
        peer.wrap, peer.unwrap = wraps
        peer.knows_us = False
        peer.given = peer.acknowledged = peer.newest = 0
        peer.keys.clear()
        self._say_more(peer)
        own = self._own
        if own is not None:
            self.has_newcomer = True
            if own.counter and self._now - own.made_s >= YOUNG_KEY_S:
                self._change_key()

    def _take_key(self, peer: _Peer, note: Note) -> None:
        suite = SUITES.get(note.suite)
        if suite is None:
            raise NoteError(f"a key for suite {note.suite}, which we do not know")
        assert peer.unwrap is not None  # the peer has been met: a note of its echoed us
        base_key = peer.unwrap.unwrap(note.wrapped_key, note.generation, note.suite)
        key_id = note.generation % KEY_IDS
        peer.newest = note.generation
        for opening in peer.keys.values():
            if opening.expires_s is None:
                opening.expires_s = self._now + LATE_FRAMES_S
        peer.keys.pop(key_id, None)
        peer.keys[key_id] = OpeningKey(note.generation, derive_key(base_key, key_id, suite))
        if len(peer.keys) > KEYS_PER_PEER:
            del peer.keys[next(iter(peer.keys))]
        self._say_more(peer)

    def _change_key(self) -> None:
        if self._generation >= MAX_GENERATION:
            raise SealError(f"{MAX_GENERATION} keys are enough for one process")
        self._generation += 1
        self.key_changes += 1
        base_key = self._random_bytes(BASE_KEY_BYTES)
        key = derive_key(base_key, self._generation % KEY_IDS, self._suite)
        self._own = _OwnKey(self._generation, base_key, key, self._now)
        for peer in self._peers.values():
            if peer.public_key is not None:
                self._say_more(peer)

    def _say_more(self, peer: _Peer) -> None:
        """There is something new to tell: do so at once, and then again with short waits."""
        peer.due_s, peer.wait_s, peer.is_repeat = self._now, FIRST_WAIT_S, False

    def _is_content(self, peer: _Peer) -> bool:
        """Whether a peer has told us all that we want to hear."""
        if not peer.knows_us:
            return False
        return self._own is None or peer.acknowledged == self._own.generation

    def _note(self, peer: _Peer) -> Note:
        own, wrap = self._own, peer.wrap
        has_key = own is not None and wrap is not None
        if own is not None and has_key:
            peer.given = own.generation
        return Note(
            public_key=self._public_key,
            echo=NOBODY if peer.public_key is None else fingerprint(peer.public_key),
            acknowledged=peer.newest,
            wants_answer=peer.is_repeat,
            generation=own.generation if own is not None and has_key else 0,
            suite=self._suite.number if has_key else 0,
            wrapped_key=(
                wrap.wrap(own.base_key, own.generation, self._suite.number)
                if own is not None and wrap is not None
                else b""
            ),
        )
