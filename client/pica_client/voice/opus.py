"""Opus by libopus itself, through ctypes: 20 or 40 ms of mono at 48 kHz in, one packet out, and
back; and the sizes of sound that a voice is captured, sent and played in.

The payload of a frame on a voice track is such a packet, of 20 ms where a mute or a hole of the
source leaves half of one. During silence nothing is sent and ``sequence`` does not count on,
``captured_us`` does. So a hole in ``sequence`` is a loss, and a leap of ``captured_us`` without one
is a silence.

PyAV's codec context does not conceal lost packets, and its encoder does not fall silent. So the
library is called directly: that of the system, or else the one that comes inside the wheel of PyAV
(extra `video`).
"""

import ctypes
import ctypes.util
import importlib.util
import math
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from pica_client.errors import VoiceError
from pica_core.types import FloatArray

SAMPLE_RATE_HZ: Final = 48_000
FRAME_SAMPLES: Final = 960
FRAME_US: Final = 20_000
FRAME_S: Final = FRAME_US / 1e6
"""What is captured and played at once."""
PACKET_FRAMES: Final = 2
"""Frames in one packet, at most (chosen: two cost 20 ms of delay and save what surrounds every
other message, 63 bytes each 40 ms; PESQ is the same)."""
MAX_OPUS_BYTES: Final = 1000
"""The longest packet that is encoded (chosen; 128 kbit/s take 640 bytes)."""
MAX_LEVEL: Final = 126
"""The softest level, see `level_of`."""

_SIZES: Final = [FRAME_SAMPLES * count for count in range(1, PACKET_FRAMES + 1)]
_LARGEST_SILENT_BYTES: Final = 2
"""A packet of the encoder that is no longer need not be sent (opus_encode, DTX)."""

_APPLICATION_VOIP = 2048
_SIGNAL_VOICE = 3001
_SET_BITRATE, _SET_VBR, _SET_DTX, _SET_SIGNAL = 4002, 4006, 4016, 4024
_RESET_STATE = 4028


def level_of(pcm: FloatArray) -> int:
    """Return decibels of the root mean square below full scale: 0 loud to 126 silent."""
    power = float(np.mean(np.square(pcm, dtype=np.float64)))
    return MAX_LEVEL if power <= 0 else min(max(round(-10 * math.log10(power)), 0), MAX_LEVEL)


def available() -> str | None:
    """Return why there is no Opus on this machine; None: there is."""
    if _library() is not None:
        return None
    return "libopus is missing: install libopus0 (Debian) or pip install 'pica-telepresence[video]'"


class OpusEncoder:
    """Turns frames of 20 ms, or two of them, into packets.

    Args:
        bitrate: Bits a second during speech, 6,000 to 128,000.
        is_constant: Whether all packets of speech have the same size.

    Raises:
        VoiceError: There is no libopus.
    """

    def __init__(self, bitrate: int = 24_000, *, is_constant: bool = False) -> None:
        self._opus, self._state = _created("encoder", SAMPLE_RATE_HZ, 1, _APPLICATION_VOIP)
        for request, value in (
            (_SET_BITRATE, bitrate),
            (_SET_SIGNAL, _SIGNAL_VOICE),
            (_SET_VBR, int(not is_constant)),
            (_SET_DTX, 1),  # it falls silent with the speaker
        ):
            self._opus.opus_encoder_ctl(self._state, request, ctypes.c_int(value))
        self._packet = ctypes.create_string_buffer(MAX_OPUS_BYTES)

    def encode(self, pcm: FloatArray) -> bytes | None:
        """Return the next packet; None where there is nothing to say.

        Args:
            pcm: Samples in [-1, 1]; what is beyond is clipped. float32 ``[960]`` or
                ``[1920]``.

        Raises:
            VoiceError: Another number of samples.
        """
        samples = np.clip(np.nan_to_num(pcm), -1.0, 1.0).astype(np.float32)
        size = self._opus.opus_encode_float(
            self._state, samples.ctypes, len(samples), self._packet, MAX_OPUS_BYTES
        )
        if size < 0:
            raise VoiceError(f"libopus cannot encode a frame: error {size}")
        packet = self._packet.raw[:size]
        # Two frames of nothing are filled up to the constant size all the same.
        num_bytes = self._opus.opus_packet_unpad(self._packet, size) if size else 0
        return None if num_bytes <= _LARGEST_SILENT_BYTES else packet

    def reset(self) -> None:
        """Forget what came before, as after a mute."""
        self._opus.opus_encoder_ctl(self._state, _RESET_STATE)

    def __del__(self) -> None:
        if getattr(self, "_state", None):
            self._opus.opus_encoder_destroy(self._state)


class OpusDecoder:
    """Turns the packets of one voice into sound.

    Raises:
        VoiceError: There is no libopus.
    """

    def __init__(self) -> None:
        self._opus, self._state = _created("decoder", SAMPLE_RATE_HZ, 1)

    def decode(self, payload: bytes | None) -> FloatArray:
        """Return the next 20 or 40 ms, float32 ``[960]`` or ``[1920]`` in [-1, 1].

        Args:
            payload: A packet; None: it is lost, and what came before goes on for 20 ms, ever more
                softly.

        Raises:
            VoiceError: The packet is none, or not of 20 or 40 ms of mono. The decoder stays usable.
        """
        if payload == b"":
            raise VoiceError("an Opus packet of 0 bytes")
        pcm = np.zeros(_SIZES[0 if payload is None else -1], np.float32)
        num_samples = self._opus.opus_decode_float(
            self._state, payload, len(payload or b""), pcm.ctypes, len(pcm), 0
        )
        if num_samples not in _SIZES:  # negative: an error of libopus
            raise VoiceError(f"an Opus packet of {num_samples} samples; one of {_SIZES} is read")
        return np.clip(np.nan_to_num(pcm[:num_samples], copy=False), -1.0, 1.0)

    def __del__(self) -> None:
        if getattr(self, "_state", None):
            self._opus.opus_decoder_destroy(self._state)


def _created(kind: str, *arguments: int) -> tuple[Any, ctypes.c_void_p]:
    """The library, and a new encoder or decoder of it."""
    library, error = _library(), ctypes.c_int()
    if library is None:
        raise VoiceError(str(available()))
    state = getattr(library, f"opus_{kind}_create")(*arguments, ctypes.byref(error))
    if not state:
        raise VoiceError(f"libopus makes no {kind}: error {error.value}")
    return library, ctypes.c_void_p(state)


@cache
def _library() -> Any:
    """Return libopus with the types of what we call, or None."""
    for name in _candidates():
        try:
            library = ctypes.CDLL(name)
            _declare(library)
        except (OSError, AttributeError):  # not there, or not what its name says
            continue
        return library
    return None


def _candidates() -> list[str]:
    """Where libopus may be: as the system names it, then beside and inside of PyAV."""
    names = [ctypes.util.find_library("opus") or ""]
    names += ["opus.dll"] if sys.platform == "win32" else ["libopus.so.0", "libopus.0.dylib"]
    spec = importlib.util.find_spec("av")
    if spec is not None and spec.origin is not None:
        package = Path(spec.origin).parent
        for folder in (package.parent / "av.libs", package / ".dylibs"):
            names += sorted(str(file) for file in folder.glob("*opus*"))
    return [name for name in names if name]


def _declare(library: Any) -> None:
    for name in ("opus_encoder_create", "opus_decoder_create"):
        getattr(library, name).restype = ctypes.c_void_p
    # Variadic: Apple's processors need to know what comes first.
    library.opus_encoder_ctl.argtypes = [ctypes.c_void_p, ctypes.c_int]
    library.opus_packet_unpad.restype = ctypes.c_int  # missing before libopus 1.1
