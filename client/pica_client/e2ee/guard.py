"""All of end-to-end encryption as one object for a link: frames out, events in, whispers between.

What cannot be opened is dropped and counted; a plain frame is never taken for want of a sealed one.
The counters are those of this side and of one room after the other; they tell no contents.
"""

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pica_client.e2ee.errors import NoteError, OpenError, ReplayedFrameError, UnknownKeyError
from pica_client.e2ee.frames import decode_header, metadata_of, open_, seal
from pica_client.e2ee.keys import KeyExchange
from pica_client.e2ee.padding import pad, unpad
from pica_client.e2ee.secret import RandomBytes, RoomSecret, load_secret
from pica_client.e2ee.status import SealStatus
from pica_client.e2ee.suites import AES_128_CTR_HMAC_SHA256_64, AES_128_GCM_SHA256_128, Suite
from pica_protocol import messages
from pica_protocol.frames import MAX_PAYLOAD_BYTES, Frame
from pica_protocol.session import ClientEvent, Closed

_MAX_HEADER_BYTES = 3
"""The longest header of our own frames: key ids fit the first byte, counters two more."""


@dataclass(kw_only=True, slots=True)
class SealCounters:
    """What was sealed, opened and refused since the guard was made."""

    sealed: int = 0
    overhead_bytes: int = 0
    """What padding and sealing added to our payloads."""
    opened: int = 0
    unreadable: int = 0
    """Frames whose key we do not have: it is not here yet, or was replaced."""
    replayed: int = 0
    """Frames that came a second time, or later than the window reaches."""
    forged: int = 0
    """Frames that were changed on their way, or are not sealed at all."""
    notes_refused: int = 0
    """Whispers that are no notes of a member."""


class Guard:
    """Stands between the session of a `transport.link.Link` and everybody else on this side.

    The link asks it before a frame goes out and before an event is handed on, and carries its
    whispers. One for each link. Pure but for its source of chance.

    Attributes:
        status: Who is verified and who is not, and the code to read aloud; a new object at each
            change, so any thread may read it. As of when we were last in the room.
    """

    def __init__(
        self,
        secret: RoomSecret,
        *,
        suite: Suite = AES_128_GCM_SHA256_128,
        pad_to: tuple[int, ...] = (),
        random_bytes: RandomBytes = os.urandom,
    ) -> None:
        """Start outside any room; see `KeyExchange`. Payloads are filled up to the sizes of
        ``pad_to``, if there are any."""
        self.counters = SealCounters()
        self.status = SealStatus()
        self._pad_to = pad_to
        self._max_padded = MAX_PAYLOAD_BYTES - _MAX_HEADER_BYTES - suite.tag_bytes
        self._keys = KeyExchange(
            secret, suite=suite, random_bytes=random_bytes, is_padded=bool(pad_to)
        )
        self._owners: dict[int, str] = {}  # by stream; bounded as the peers of a session are
        self._own_streams: tuple[int, ...] = ()

    @property
    def members(self) -> frozenset[str]:
        """The ids of those in the room who have proven to be here, and to know the secret."""
        return self._keys.members

    def stats(self) -> dict[str, Any]:
        """Return the counters and the state of the keys, for people and reports."""
        return {
            **asdict(self.counters),
            "key_changes": self._keys.key_changes,
            "members": self.status.num_verified,
            "code": self.status.code,
            "peers": {
                peer_id: {"state": peer.state.value, "reason": peer.reason}
                for peer_id, peer in self.status.peers.items()
            },
        }

    def begin(self, room: str, name: str) -> None:
        """We are about to join a room, and will be shown under this name.

        Called before each join; what the relay answers cannot change it.
        """
        self._keys.begin(room, name)

    def seal(self, frame: Frame) -> bytes:
        """Return the payload to send instead of the frame's own, once its header is final.

        Raises:
            SealError: We are in no room.
        """
        key, counter = self._keys.next_counter()
        payload = frame.payload
        if self._pad_to:
            payload = pad(payload, self._pad_to, self._max_padded)
        sealed = seal(payload, metadata_of(frame), key, counter)
        self.counters.sealed += 1
        self.counters.overhead_bytes += len(sealed) - len(frame.payload)
        return sealed

    def receive_event(self, event: ClientEvent, now: float) -> list[ClientEvent]:
        """Take an event of the session and return what the owner of the link gets instead.

        Whispers end here and frames come out plain. A newcomer who can read our frames from now on
        needs one to begin with: that shows as a `KeyframeRequest` for each of our streams.
        """
        if isinstance(event, Frame):
            return self._open(event, now)
        events = self._receive_news(event, now)
        if not isinstance(event, Closed):
            self.status = self._keys.status()
        return events

    def _receive_news(self, event: ClientEvent, now: float) -> list[ClientEvent]:
        match event:
            case messages.Whisper(peer_id=peer_id, data=data):
                try:
                    self._keys.receive_note(peer_id, data, now)
                except NoteError:
                    self.counters.notes_refused += 1
                if not self._keys.has_newcomer:
                    return []
                self._keys.has_newcomer = False
                return [messages.KeyframeRequest(stream=stream) for stream in self._own_streams]
            case messages.Joined(tracks=tracks, peers=peers):
                self._keys.receive_joined(event, now)
                # Only these know keyframes; of other tracks each frame stands alone.
                self._own_streams = tuple(t.stream for t in tracks if t.policy == "latest")
                self._owners.clear()
                for peer in peers:
                    self._note_streams(peer)
            case messages.PeerJoined(peer=peer):
                self._keys.receive_peer_joined(peer, now)
                self._note_streams(peer)
            case messages.PeerLeft(peer_id=peer_id):
                self._keys.receive_peer_left(peer_id, now)
                self._owners = {s: who for s, who in self._owners.items() if who != peer_id}
            case messages.PeerBack(peer_id=peer_id):
                self._keys.receive_peer_back(peer_id, now)
            case Closed():
                self._keys.receive_closed(now)
                self._owners.clear()
        return [event]

    def messages_to_send(self, now: float) -> list[tuple[str, bytes]]:
        """Take the whispers that must go out now, peer ids and data: before every frame that was
        sealed before this call."""
        notes = self._keys.messages_to_send(now)
        if notes:
            self.status = self._keys.status()
        return notes

    def next_timer(self) -> float | None:
        """Return when `handle_timer` is due, or None."""
        return self._keys.next_timer()

    def handle_timer(self, now: float) -> None:
        """Do what is due by now."""
        self._keys.handle_timer(now)

    def _note_streams(self, peer: messages.Peer) -> None:
        for track in peer.tracks:
            self._owners[track.stream] = peer.peer_id

    def _open(self, frame: Frame, now: float) -> list[ClientEvent]:
        counters, owner = self.counters, self._owners.get(frame.stream)
        try:
            payload = self._opened(frame, owner, now)
        except UnknownKeyError:
            counters.unreadable += 1
            if owner is not None:
                self._keys.receive_unreadable(owner, now)
        except ReplayedFrameError:
            counters.replayed += 1
        except OpenError:
            counters.forged += 1
        else:
            counters.opened += 1
            return [replace(frame, payload=payload)]
        return []

    def _opened(self, frame: Frame, owner: str | None, now: float) -> bytes:
        header, _ = decode_header(frame.payload)
        if owner is None:
            raise UnknownKeyError("a frame of nobody in the room")
        opening = self._keys.opening_key(owner, header.key_id, now)
        if opening is None:
            raise UnknownKeyError(f"no key {header.key_id} of this peer")
        if not opening.window.is_new(header.counter):
            raise ReplayedFrameError(f"counter {header.counter} came before")
        payload = open_(frame.payload, metadata_of(frame), opening.key)
        opening.window.mark(header.counter)
        return unpad(payload) if opening.is_padded else payload


def guard_from(
    secret_file: Path, *, short_tags: bool = False, pad_to: tuple[int, ...] = ()
) -> Guard:
    """Return a guard for a command that was given the file with the room secret.

    Args:
        secret_file: As `pica secret` writes it.
        short_tags: Seal with tags of 8 bytes instead of 16, see `pica_client.e2ee.suites`.
        pad_to: Sizes that payloads are filled up to, see `pica_client.e2ee.padding`.

    Raises:
        SecretFileError: The file holds no secret.
    """
    suite = AES_128_CTR_HMAC_SHA256_64 if short_tags else AES_128_GCM_SHA256_128
    return Guard(load_secret(secret_file), suite=suite, pad_to=pad_to)
