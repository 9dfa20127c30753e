"""Lips that go on by the voice while their face stands still for want of frames.

What the last frame showed stays, brows and head too; the mouth moves on from there by what the
voice's mouth has done since, in the code of the avatar:

    shown = held + weight * (encoded(mouth that is heard) - encoded(mouth when the face stopped))

So the seam begins with no step, and what was added fades when frames come again. Packets come in on
the network's thread, faces go out on the drawing one; they meet in a bounded deque.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.jitter_buffer import CODEC_DELAY_S, Decoder
from pica_client.voice.packet import FRAME_S, SAMPLE_RATE_HZ, VoicePacket
from pica_client.voice.spoken_face import SpokenMouth
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.types import FloatArray

STANDS_US: Final = 30_000
"""A face this far behind its voice stands still (chosen: below what is seen)."""
FADE_S: Final = 0.15
"""How long what was added takes to go, and to come."""
WARM_PACKETS: Final = 12
"""What is kept of a voice until it is needed: the network has to have heard half a second."""
MAX_MADE_UP: Final = 5
"""Frames of concealment in a row, as in the jitter buffer."""
MAX_PEERS: Final = 64


@dataclass(slots=True)
class _Lips:
    decoder: Decoder
    mouth: SpokenMouth = field(default_factory=SpokenMouth)
    packets: deque[VoicePacket] = field(default_factory=lambda: deque(maxlen=WARM_PACKETS))
    end_s: float = -math.inf
    """Where the sound that has come ends."""
    num_made_up: int = 0
    """Frames of concealment that were heard after it."""
    encoder: ExpressionEncoder | None = None
    held_us: int | None = None
    """When the face stopped; None while it moves."""
    before: FloatArray | None = None
    """The code of the voice's mouth then."""
    added: FloatArray | None = None
    weight: float = 0.0
    now: float = 0.0


class HeldLips:
    """Moves the lips of faces that stand still; one for all peers."""

    def __init__(self, make_decoder: Callable[[], Decoder]) -> None:
        self._make_decoder = make_decoder
        self._lips: dict[str, _Lips] = {}

    def receive(self, peer_id: str, packet: VoicePacket) -> None:
        """Take a packet of somebody's voice."""
        lips = self._lips.get(peer_id)
        if lips is None:
            if len(self._lips) >= MAX_PEERS:
                return
            lips = self._lips[peer_id] = _Lips(self._make_decoder())
        lips.packets.append(packet)

    def keep(self, peer_ids: set[str]) -> None:
        """Forget everybody else."""
        self._lips = {who: lips for who, lips in self._lips.items() if who in peer_ids}

    def move(
        self,
        peer_id: str,
        avatar: Avatar,
        latent: FloatArray,
        shown_us: int,
        heard_us: int | None,
        now: float,
    ) -> tuple[FloatArray, int]:
        """The face to show, and the moment that its lips are of.

        Args:
            avatar: Whose codes it is of.
            latent: What the playout shows. float32 ``[8, 8, 4]``.
            shown_us: The moment that it is of, sender's clock.
            heard_us: The moment of the voice that is heard; None: there is none.
            now: Our clock.
        """
        lips = self._lips.get(peer_id)
        if lips is None:
            return latent, shown_us
        elapsed_s, lips.now = min(max(now - lips.now, 0.0), FADE_S), now
        if heard_us is None or heard_us - shown_us <= STANDS_US:
            lips.held_us = None
            lips.weight = max(lips.weight - elapsed_s / FADE_S, 0.0)
            if lips.weight == 0.0 or lips.added is None:
                return latent, shown_us
            return latent + np.float32(lips.weight) * lips.added, shown_us
        self._listen(lips, heard_us / 1e6)
        if lips.encoder is None:
            lips.encoder = ExpressionEncoder(avatar)
        if lips.held_us != shown_us or lips.before is None:
            lips.held_us = shown_us
            lips.before = lips.encoder.encode(lips.mouth.at(shown_us / 1e6))
        lips.weight = min(lips.weight + elapsed_s / FADE_S, 1.0)
        moment_s = min(heard_us / 1e6, max(lips.mouth.newest_s, shown_us / 1e6))
        lips.added = lips.encoder.encode(lips.mouth.at(moment_s)) - lips.before
        return latent + np.float32(lips.weight) * lips.added, round(moment_s * 1e6)

    @staticmethod
    def _listen(lips: _Lips, heard_s: float) -> None:
        """Hear what has come meanwhile, ahead of what leaves the loudspeaker.

        The mouth is known `DELAY_S` after its sound: at the end of what has come, the codec's
        concealment stands for what follows, as it does in the loudspeaker.
        """
        while lips.packets:
            packet = lips.packets.popleft()
            try:
                sound = lips.decoder.decode(packet.payload)
            except VoiceError:
                continue
            begin_s = packet.captured_us / 1e6 - CODEC_DELAY_S
            lips.mouth.hear(sound, begin_s)
            lips.end_s, lips.num_made_up = begin_s + len(sound) / SAMPLE_RATE_HZ, 0
        while lips.mouth.newest_s < heard_s <= lips.end_s and lips.num_made_up < MAX_MADE_UP:
            begin_s = lips.end_s + lips.num_made_up * FRAME_S
            lips.mouth.hear(lips.decoder.decode(None), begin_s)
            lips.num_made_up += 1
