"""All that reads bytes of strangers, as functions of bytes, and good inputs to damage for each.

Each target accepts its bytes or refuses them with a documented error; what else it raises is a
defect. A media message is a bundle of frames. What lies behind a code that nobody can forge (a
seal, a key message) is read as far as the code.
"""

import io
import json
import struct
import tempfile
import wave
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from hypothesis import strategies as st

from fuzzing.damage import MEDIA, damaged_avatar, damaged_bytes, damaged_control, damaged_glb
from golden.wire_samples import GOLDEN
from helpers import tracker_packets
from helpers.rig_toy import glb_bytes, glb_parts, toy_rig
from helpers.stream_toy import perform, toy_decoder
from helpers.toy import make_toy_avatar, with_bases
from pica_client.e2ee.frames import decode_header, derive_key, open_, seal
from pica_client.e2ee.peer_keys import KeyMessage, decode, encode, room_key
from pica_client.e2ee.secret import RoomSecret
from pica_client.errors import SealError, SourceError
from pica_client.sources.datagrams import REQUESTS, decoder_of
from pica_client.sources.live_face import PacketError
from pica_client.sources.registry import load_livelink_csv
from pica_client.sources.webcam import open_camera, pictures
from pica_client.voice.source import read_wav
from pica_core.avatar.file import load_avatar, save_avatar
from pica_core.avatar.spec import AvatarSpec
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.head import make_rig
from pica_core.capture.rig.mesh import build_mesh
from pica_core.capture.rig.names import map_names
from pica_core.errors import AvatarFileError, CaptureError, LatentError
from pica_core.livelink import livelink_csv
from pica_core.types import MAX_LATENT_LENGTH
from pica_protocol.codec import decode_message, encode_message
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.frames import (
    Frame,
    clear_header,
    decode_media,
    encode_frame,
    media_message,
    scan_frames,
)

WAY: Final = ("p1", "p2")
CODE_KEY: Final = room_key(RoomSecret(bytes(range(32))), "lobby", b"code")
RIG: Final = glb_parts(toy_rig())
METADATA: Final = clear_header(Frame(stream=1, sequence=2, captured_us=3, payload=b""))


GOLDEN_BYTES: Final[dict[str, bytes]] = {
    f"{group} {name}": bytes.fromhex(text)
    for group, vectors in json.loads(GOLDEN.read_text()).items()
    for name, text in vectors.items()
}
"""Every vector of the golden file: valid and invalid ones."""


def expect(is_so: bool, *what: object) -> None:
    """Raise AssertionError unless something is so."""
    if not is_so:
        raise AssertionError(" ".join(map(str, what)))


def message(data: bytes) -> None:
    """Read a control message; what was read says the same when it is written and read again."""
    with suppress(RemoteProtocolError):
        found = decode_message(data)
        expect(decode_message(encode_message(found)) == found, "not what was read:", found)


def media(data: bytes) -> None:
    """Read a bundle of frames, as a receiver and as the relay do: they must agree."""
    try:
        frames = decode_media(data)
    except RemoteProtocolError:
        with suppress(RemoteProtocolError):
            expect(not scan_frames(data), "the relay forwards what nobody reads")
        return
    spans = scan_frames(data)
    expect(
        [stream for stream, *_ in spans] == [f.stream for f in frames], "frames of other streams"
    )
    written = media_message(map(encode_frame, frames))
    expect(decode_media(written) == frames, "not what was read:", frames)


def sealed(data: bytes) -> None:
    """Read a sealed payload."""
    with suppress(SealError):
        decode_header(data)
        open_(data, METADATA, derive_key(bytes(16), 7))


def key_message(data: bytes) -> None:
    """Read a message about keys."""
    decode(data, CODE_KEY, WAY)


def avatar_file(data: bytes) -> None:
    """Read an avatar file with all of its checks."""
    with suppress(AvatarFileError):
        load_avatar(data)


def bitstream(data: bytes) -> None:
    """Read a frame of a latent stream; its face is bounded, which NaN is not."""
    with suppress(LatentError):
        latent = toy_decoder().decode(data).latent
        expect(
            float(np.linalg.norm(latent)) <= 1.001 * MAX_LATENT_LENGTH, "a face beyond the limit"
        )


def datagram(data: bytes) -> None:
    """Read a datagram as one of each tracker; what a face has is finite."""
    for kind in ("livelink", "vmc", *REQUESTS):
        with suppress(PacketError):
            for sample in decoder_of(kind)(data):
                known = sample.arkit[~np.isnan(sample.arkit)]
                expect(bool(np.isfinite([*known, *sample.rotation]).all()), "an endless face")


def rig(data: bytes) -> None:
    """Read the rig of a stranger, and make it a mesh where it is one."""
    with _file(data) as path, suppress(CaptureError):
        build_mesh(source := read_rig(path), map_names(list(source.shapes)))


def head(data: bytes) -> None:
    """Make a head of a stranger's rig, and pose it."""
    with _file(data) as path, suppress(CaptureError):
        made = make_rig(read_rig(path))
        for value in (0.0, 0.7, 1.0):
            expect(bool(np.isfinite(made.vertices([value] * 52)).all()), "an endless head")


def take(data: bytes) -> None:
    """Play a recording of a face; what it has is finite."""
    with _file(data) as path, suppress(SourceError):
        recording = load_livelink_csv(path)
        for time_s in (-1.0, 0.0, 0.01, recording.duration_s):
            face = recording.frame_at(time_s)
            expect(bool(np.isfinite([*face.arkit, *face.rotation]).all()), "an endless face")


def film(data: bytes) -> None:
    """Show the first pictures of a film as a camera's; they come in order."""
    with _file(data) as path, suppress(SourceError), closing(open_camera(str(path))) as container:
        times_s = [at for _, at in islice(pictures(container, True, lambda wait_s: False), 40)]
        expect(times_s == sorted(times_s), "pictures out of order")


def sound(data: bytes) -> None:
    """Read a sound."""
    with _file(data) as path, suppress(SourceError):
        expect(bool((np.abs(read_wav(path)) < 2).all()), "a sound beyond its range")


@contextmanager
def _file(data: bytes) -> Iterator[Path]:
    """A file that holds some bytes."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        yield Path(file.name)


TARGETS: Final[Mapping[str, Callable[[bytes], None]]] = {
    each.__name__: each
    for each in (
        *(message, media, sealed, key_message, avatar_file, bitstream, datagram),
        *(rig, head, take, film, sound),
    )
}


def damaged(name: str, good: list[bytes]) -> st.SearchStrategy[bytes]:
    """Return a strategy of damaged inputs of a target."""
    match name:
        case "message":
            return damaged_control(good) | damaged_bytes(good)
        case "media":
            return MEDIA | damaged_bytes(good)
        case "rig" | "head":
            return damaged_glb(*RIG) | damaged_bytes(good)
        case "avatar_file":
            return damaged_avatar(good[0]) | damaged_bytes(good)
    return damaged_bytes(good)


def seeds() -> dict[str, list[bytes]]:
    """Return good inputs of each target, made by the code as it is now.

    They are the golden bytes of the wire, a sealed frame, a key message, a stream, an avatar,
    datagrams and takes of trackers; films and sounds where PyAV is installed.
    """
    values = dict.fromkeys(tracker_packets.LIVE_LINK_ORDER[:52], 0.5)
    told = KeyMessage(False, bytes(32), bytes(8), bytes(8), 0, 1, 0, bytes(32))
    spec = AvatarSpec(uv_encoding_size=4, axis_encoding_size=4)
    with tempfile.TemporaryDirectory() as folder:
        avatar = Path(folder, "toy.pica")
        save_avatar(avatar, with_bases(make_toy_avatar(grid=3, spec=spec)))
        avatar_bytes = avatar.read_bytes()
    wire = list(GOLDEN_BYTES.values())
    return {
        "message": [data for data in wire if data[:1] != b"\x02"],
        "media": [data for data in wire if data[:1] == b"\x02"],
        "sealed": [seal(b"face", METADATA, derive_key(bytes(16), 7), 4)],
        "key_message": [encode(told, CODE_KEY, WAY, bytes(32), bytes(16))],
        "avatar_file": [avatar_bytes],
        "rig": [glb_bytes(*RIG)],
        "head": [glb_bytes(*RIG)],
        "bitstream": [sent.payload for sent in perform(num_frames=40)],
        "datagram": [
            tracker_packets.live_link(values, frame=5),
            tracker_packets.live_link(None),
            tracker_packets.vmc(values, seconds=1.0, bones={"Head": (0.0, 0.0, 0.0, 1.0)}),
            tracker_packets.ifacialmocap({"jawOpen": 3}),
        ],
        "take": [
            livelink_csv([(0.0, [0.5] * 55), (0.02, None), (0.04, [0.0] * 55)]).encode(mode)
            for mode in ("utf-8", "utf-8-sig")
        ],
        "film": _films("mp4", "matroska", "mpegts", "avi"),
        "sound": [_wav(header_bytes) for header_bytes in (None, 0, 2**32 - 1)],
    }


def _films(*forms: str) -> list[bytes]:
    """The same small film in several containers."""
    if find_spec("av") is None:
        return []
    import av

    films = []
    for form in forms:
        with av.open(file := io.BytesIO(), "w", format=form) as container:
            stream = container.add_stream("mpeg4", rate=10)
            stream.width, stream.height = 32, 48
            for grey in range(0, 250, 50):
                picture = np.full((48, 32, 3), grey, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
            container.mux(stream.encode())
        films.append(file.getvalue())
    return films


def _wav(length: int | None) -> bytes:
    """A short sound whose header names a length of its data, or the right one."""
    with wave.open(file := io.BytesIO(), "wb") as out:
        out.setparams((1, 2, 48_000, 0, "NONE", ""))
        out.writeframes(bytes(range(200)) * 4)
    data = file.getvalue()
    return data if length is None else data[:40] + struct.pack("<I", length) + data[44:]
