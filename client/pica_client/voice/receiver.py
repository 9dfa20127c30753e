"""Voices on their way in: from frames of the link to those of a person. Pure.

What is wrong with one voice stays with that voice: one of an unknown codec is named once, in words,
and not subscribed to.
"""

import logging
from collections.abc import Callable
from typing import Any

from pica_client.tracks import voice_of, voice_refusal
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft
from pica_protocol.session import ClientEvent

OnVoice = Callable[[str, Frame, float], None]
"""Takes a peer's id, a packet of its voice, see `voice.packet`, and when it arrived, seconds of our
clock. Called on the network's thread, for every packet in the order of arrival."""

_log = logging.getLogger(__name__)


class VoiceReceiver:
    """Tells voices from faces, and hands them on.

    Attributes:
        refused: Why a peer cannot be heard, in words, by peer id.
    """

    def __init__(self, on_voice: OnVoice | None) -> None:
        """Begin outside any room; without ``on_voice`` no voice is wanted."""
        self._on_voice = on_voice
        self._peers: dict[int, str] = {}  # by stream; bounded by the protocol's limit on peers
        self.refused: dict[str, str] = {}
        self.received = 0

    def receive_event(self, event: ClientEvent, now: float) -> bool:
        """Take an event of the link's session; return True if it was a voice's alone."""
        match event:
            case Frame(stream=stream) if stream in self._peers:
                peer_id = self._peers[stream]
                if self._on_voice is not None and peer_id not in self.refused:
                    self.received += 1
                    self._on_voice(peer_id, event, now)
                return True
            case Joined(peers=peers):
                self._peers.clear()
                self.refused.clear()
                for peer in peers:
                    self._add(peer)
            case PeerJoined(peer=peer):
                self._add(peer)
            case PeerLeft(peer_id=peer_id):
                self._peers = {s: who for s, who in self._peers.items() if who != peer_id}
                self.refused.pop(peer_id, None)
            case _:
                pass
        return False

    def is_wanted(self, stream: int) -> bool:
        """Return True if a stream is a voice that is heard here."""
        peer_id = self._peers.get(stream)
        return peer_id is not None and self._on_voice is not None and peer_id not in self.refused

    def stats(self) -> dict[str, Any]:
        """What came so far."""
        return {"received": self.received, "refused": dict(self.refused)}

    def _add(self, peer: Peer) -> None:
        track = voice_of(peer)
        if track is None:
            return
        self._peers[track.stream] = peer.peer_id
        if self._on_voice is not None and (reason := voice_refusal(track)):
            self.refused[peer.peer_id] = reason
            _log.warning("a voice cannot be heard", extra={"reason": reason})
