"""Who has which key of whom: the state machine that makes, gives, takes and drops keys. Pure.

Every peer has a *sender key*, random, with a generation that counts up. Every other peer that
proves to know the room secret, and describes itself as the relay does, is given it, wrapped for
that peer alone. The rules:

- Whoever is new to us, or has not said that it has our key, is sent a note, again and again with
  growing waits, until it has, and until we have its key.
- When somebody who was given our key leaves, or takes another public key, we make a new one at
  once, before the next frame.
- When somebody comes, likewise, so that nobody opens what was sent before; except that a key that
  has sealed nothing, or is younger than `YOUNG_KEY_S`, is not changed for this. With a key a peer
  is told the counter from which it is theirs: no frame opens on two connections of one receiver.
- A key seals `FRAMES_PER_KEY` frames, then comes the next.
- A key of theirs that was followed by a newer one opens for `LATE_FRAMES_S` more.

Notes leave before the frames that need them: on one connection they arrive in that order. So a new
key is used at once, and nobody misses a frame unless a note is lost.

What is known of a peer grows in steps: nothing, its public key (a note came), that it knows ours
(the note echoed it), that it has our key (the note acknowledged it). The first public key that
comes stays, until a note with another one echoes our present key: such a note cannot be an old one
that the relay repeats. A public key that was given up never comes back.

The relay says who comes and goes, and may lie. So what we know of a public key outlives a leave or
a return, as long as our own key does: its newest generation is the floor, and no key at or below it
is ever taken again. Whoever comes under an id that was here, or with a public key that was (after a
break; a cluster that was cut in two; a leave that was a lie), has to acknowledge our key of now
before we take one: only a living peer can. It is told so, and gives its key from the counter on at
which it took ours; or a newer one, if what it has is not above the floor.

Everything is bounded: peers by the room, keys of a peer by `KEYS_PER_PEER`, floors by `MAX_FLOORS`,
notes by a rate below the relay's own limit.
"""

from dataclasses import replace
from typing import Final

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from pica_client.e2ee import notes
from pica_client.e2ee.description import describe
from pica_client.e2ee.errors import NoteError, SealError
from pica_client.e2ee.frames import FrameKey, derive_key
from pica_client.e2ee.peer_keys import FIRST_WAIT_S, OpeningKey, OwnKey, PeerKeys, ReplayWindow
from pica_client.e2ee.secret import RandomBytes, RoomSecret
from pica_client.e2ee.status import PeerSeal, SealState, SealStatus
from pica_client.e2ee.suites import AES_128_GCM_SHA256_128, SUITES, Suite
from pica_protocol.limits import MAX_PEERS
from pica_protocol.messages import Joined, Peer

KEY_IDS: Final = 8
"""Key ids go round: so many fit the config byte of a sealed payload, and cost nothing."""
KEYS_PER_PEER: Final = 4
"""Keys of one peer that we hold; half of `KEY_IDS`, so no two share an id."""
MAX_FLOORS: Final = 4096
"""Public keys and ids of those who left that we remember (chosen: 300 KB). One more, and we take
another key of our own, which makes all that was said to the last one worthless."""
FRAMES_PER_KEY: Final = 65_536
"""Then a key changes: counters stay within two bytes. 36 minutes at 30 frames a second."""
YOUNG_KEY_S: Final = 1.0
"""Whoever comes may open what was sealed so long before (chosen: a full room coming at once costs
one change of keys a second)."""
LATE_FRAMES_S: Final = 2.0
"""How long a key that was replaced still opens what is under way (chosen: longer than a relay lets
a slow reader lag)."""
LONGEST_WAIT_S: Final = 8.0
"""Between two notes to a peer that does not answer; doubles from `FIRST_WAIT_S` to this."""
ANSWER_WAIT_S: Final = 0.1
"""Least time between two notes to a peer that has nothing new to say."""
ASK_WAIT_S: Final = 1.0
"""Least time between two notes that ask for a missing key."""
SILENT_S: Final = 3.0
"""Who has said nothing of keys for so long counts as one who does not encrypt."""
NOTES_PER_S: Final = 12.0
NOTES_AT_ONCE: Final = 96.0
"""How many notes go out; a little below what a relay passes on (16 a second, 128 at once)."""

_ONE_NOTE = 1 - 1e-6
"""A timer that fires just in time finds a budget of one, give or take rounding."""
_GIVEN_UP: Final = notes.MAX_GENERATION
"""The floor of a public key that another one has replaced."""


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
        is_padded: bool = False,
    ) -> None:
        """Start outside any room.

        Args:
            random_bytes: Where keys come from.
            suite: What we seal with; we open what any suite we know has sealed.
            is_padded: Whether we pad our payloads; said with each key.
        """
        self.key_changes = 0
        self.has_newcomer = False
        self._secret = secret
        self._random_bytes = random_bytes
        self._suite = suite
        self._is_padded = is_padded
        self._peers: dict[str, PeerKeys] = {}
        self._own: OwnKey | None = None
        self._generation = 0
        self._floors: dict[bytes, int] = {}
        self._left: set[str] = set()
        self._now = 0.0
        self._budget = NOTES_AT_ONCE
        self._budget_s = 0.0

    # What happened

    def begin(self, room: str, name: str) -> None:
        """We are about to ask for this room, and will be shown under this name. Whatever the relay
        says later, keys are bound to that."""
        self._room, self._name = room, name
        self._room_keys = notes.RoomKeys.of(self._secret, room)

    def receive_joined(self, joined: Joined, now: float) -> None:
        """We are in a room: begin anew, with keys that are used nowhere else."""
        self.receive_closed(now)
        self._own_id = joined.peer_id
        self._description = describe(self._room, self._name, joined.tracks)
        self._draw_key_pair()
        for peer in joined.peers:
            self.receive_peer_joined(peer, now)

    def receive_peer_joined(self, peer: Peer, now: float) -> None:
        """Somebody came in, or came back: it has to show itself anew."""
        self.receive_peer_left(peer.peer_id, now)
        if len(self._peers) < MAX_PEERS:
            self._peers[peer.peer_id] = self._stranger(peer)

    def receive_peer_back(self, peer_id: str, now: float) -> None:
        """Somebody is here on a new connection, and has forgotten its keys and ours."""
        known = self._peers.get(peer_id)
        if known is not None:
            self.receive_peer_joined(known.peer, now)

    def receive_peer_left(self, peer_id: str, now: float) -> None:
        """Somebody went: the key that was theirs to open with is no longer ours to seal with."""
        self._now = now
        peer = self._peers.pop(peer_id, None)
        if peer is not None:
            self._left.add(peer_id)
            self._part(peer, peer.newest)

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
        try:
            self._take_note(peer, data)
        except NoteError as error:
            # What the relay makes up, or repeats, costs a member that has proved itself nothing.
            if error.state is not None and not peer.is_verified:
                peer.seal = PeerSeal(error.state, str(error))
            raise
        if peer.is_verified:
            peer.seal = PeerSeal(SealState.VERIFIED, "encrypted, and who it says it is")
        elif peer.seal.state is not SealState.WAITING:
            peer.seal = PeerSeal()

    def _take_note(self, peer: PeerKeys, data: bytes) -> None:
        now, sender, receiver = self._now, peer.peer.peer_id, self._own_id
        note = notes.decode_note(data, self._room_keys.note_key, sender, receiver)
        if note.description != peer.description:
            raise NoteError(
                "the relay gives it another name, avatar, track or stream than it has itself",
                SealState.RELABELLED,
            )
        echoes_us = note.echo == notes.fingerprint(self._public_key)
        if note.public_key != peer.public_key:
            if peer.public_key is None or echoes_us:
                self._meet(peer, note.public_key)
            else:  # let it prove itself
                note = notes.Note(public_key=note.public_key, wants_answer=True)
        if echoes_us:
            peer.knows_us = True
            peer.acknowledged = max(peer.acknowledged, min(note.acknowledged, self._generation))
            if note.wrapped_key and note.generation > peer.newest:
                self._take_key(peer, note)
            if note.wants_newer and note.acknowledged >= self._generation and self._is_key_old:
                self._change_key()
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
        ready = []
        for _, peer_id, peer in sorted(due, key=lambda item: item[0]):
            if self._budget < _ONE_NOTE:
                break
            self._budget -= 1
            note, note_key = self._note(peer), self._room_keys.note_key
            ready.append((peer_id, notes.encode_note(note, note_key, self._own_id, peer_id)))
            peer.sent_s = now
            is_silent = peer.public_key is None and now - peer.came_s >= SILENT_S
            if is_silent and peer.seal.state is SealState.WAITING:
                peer.seal = PeerSeal(
                    SealState.PLAIN,
                    "says nothing of keys: it has no secret file, is away, or is kept from it",
                )
            if self._is_content(peer):
                peer.due_s, peer.is_repeat = None, False
            else:
                peer.due_s, peer.is_repeat = now + peer.wait_s, True
                peer.wait_s = min(2 * peer.wait_s, LONGEST_WAIT_S)
        return ready

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
            SealError: We are in no room.
        """
        if self._own is not None and self._own.counter >= FRAMES_PER_KEY:
            self._change_key()
        own = self._own
        if own is None:
            raise SealError("there is no key to seal with: not in a room")
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
        """The ids of those in the room who have proven to be here, and to know the secret."""
        return frozenset(peer_id for peer_id, peer in self._peers.items() if peer.is_verified)

    def status(self) -> SealStatus:
        """Return how everybody's encryption stands."""
        members = [(self._public_key, self._description)]
        for peer in self._peers.values():
            if peer.given and peer.public_key is not None:
                members.append((peer.public_key, peer.description))
        seals = {peer_id: peer.seal for peer_id, peer in self._peers.items()}
        return SealStatus(room=self._room, peers=seals, members=tuple(members))

    def _stranger(self, peer: Peer) -> PeerKeys:
        description = describe(self._room, peer.name, peer.tracks)
        is_returned = peer.peer_id in self._left
        return PeerKeys(peer, description, self._now, self._now, is_returned=is_returned)

    def _draw_key_pair(self) -> None:
        """Take another public key; all that was agreed with the last one is worth nothing now."""
        self._private = X25519PrivateKey.from_private_bytes(
            self._random_bytes(notes.PUBLIC_KEY_BYTES)
        )
        self._public_key = self._private.public_key().public_bytes_raw()
        self._floors.clear()
        self._left.clear()
        for peer_id, known in self._peers.items():
            self._peers[peer_id] = self._stranger(known.peer)
        # Nobody is known to have the key that we seal with, so nobody's leaving would change it.
        self._change_key()

    def _part(self, peer: PeerKeys, floor: int) -> None:
        """Do without a public key: remember how far it came, and seal with what it cannot open."""
        if peer.public_key is not None:
            self._floors[peer.public_key] = floor
        if len(self._floors) + len(self._left) > MAX_FLOORS:
            self._draw_key_pair()
        if self._own is not None and peer.given == self._own.generation:
            self._change_key()

    def _meet(self, peer: PeerKeys, public_key: bytes) -> None:
        """Learn a public key: from now on the peer can be given ours."""
        floor = self._floors.get(public_key)
        if floor == _GIVEN_UP:
            raise NoteError("a public key that was given up")
        if public_key == self._public_key or any(
            public_key == other.public_key for other in self._peers.values()
        ):
            raise NoteError("a public key of somebody else in the room")
        wraps = notes.agree(self._private, self._public_key, public_key, self._room_keys.pair_salt)
        if peer.public_key is not None:
            self._part(peer, _GIVEN_UP)
        peer.is_returned = peer.is_returned or floor is not None
        peer.public_key = public_key
        peer.wrap, peer.unwrap = wraps
        peer.knows_us = False
        peer.given = peer.acknowledged = 0
        peer.newest = floor or 0
        peer.proof = self._generation if peer.is_returned else 1
        peer.keys.clear()
        self._say_more(peer)
        self.has_newcomer = True
        if self._own is not None:
            peer.first = self._own.counter
            if peer.first and self._is_key_old:
                self._change_key()

    @property
    def _is_key_old(self) -> bool:
        return self._own is not None and self._now - self._own.made_s >= YOUNG_KEY_S

    def _take_key(self, peer: PeerKeys, note: notes.Note) -> None:
        if peer.is_returned and peer.acknowledged < peer.proof:
            return  # this may be an old note; the next one shows whether it is
        suite = SUITES.get(note.suite)
        if suite is None:
            raise NoteError(f"a key for suite {note.suite}, which we do not know")
        assert peer.unwrap is not None  # the peer has been met: a note of its echoed us
        base_key = peer.unwrap.unwrap(note.wrapped_key, note.generation, note.suite)
        key_id = note.generation % KEY_IDS
        peer.newest = note.generation
        if note.wants_newer and self._own is not None:
            peer.first = self._own.counter  # what was before is not for it
        for opening in peer.keys.values():
            if opening.expires_s is None:
                opening.expires_s = self._now + LATE_FRAMES_S
        peer.keys.pop(key_id, None)
        key, window = derive_key(base_key, key_id, suite), ReplayWindow(note.first)
        peer.keys[key_id] = OpeningKey(note.generation, key, note.is_padded, window)
        if len(peer.keys) > KEYS_PER_PEER:
            del peer.keys[next(iter(peer.keys))]
        self._say_more(peer)

    def _change_key(self) -> None:
        if self._generation >= notes.MAX_GENERATION:
            raise SealError(f"{notes.MAX_GENERATION} keys are enough for one process")
        self._generation += 1
        self.key_changes += 1
        base_key = self._random_bytes(notes.BASE_KEY_BYTES)
        key = derive_key(base_key, self._generation % KEY_IDS, self._suite)
        self._own = OwnKey(self._generation, base_key, key, self._now)
        for peer in self._peers.values():
            if peer.public_key is not None:
                peer.first = 0
                self._say_more(peer)

    def _say_more(self, peer: PeerKeys) -> None:
        """There is something new to tell: do so at once, and then again with short waits."""
        peer.due_s, peer.wait_s, peer.is_repeat = self._now, FIRST_WAIT_S, False

    def _is_content(self, peer: PeerKeys) -> bool:
        """Whether a peer has told us all that we want to hear."""
        return peer.knows_us and peer.acknowledged == self._generation and bool(peer.keys)

    def _note(self, peer: PeerKeys) -> notes.Note:
        own, wrap = self._own, peer.wrap
        assert own is not None  # a note is written in a room
        note = notes.Note(
            public_key=self._public_key,
            description=self._description,
            acknowledged=peer.newest,
            wants_answer=peer.is_repeat,
            wants_newer=peer.is_returned and not peer.keys,
        )
        if peer.public_key is None or wrap is None:
            return note
        peer.given = own.generation
        return replace(
            note,
            echo=notes.fingerprint(peer.public_key),
            generation=own.generation,
            first=peer.first,
            suite=self._suite.number,
            is_padded=self._is_padded,
            wrapped_key=wrap.wrap(own.base_key, own.generation, self._suite.number),
        )
