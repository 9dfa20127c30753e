"""Writes a photo as phones do: HEIC, a frame of H.265 in boxes of ISO/IEC 23008-12."""

import struct

import av
from PIL import Image


def _box(kind: bytes, *parts: bytes, version: int | None = None) -> bytes:
    head = b"" if version is None else struct.pack(">I", version << 24)
    content = head + b"".join(parts)
    return struct.pack(">I4s", 8 + len(content), kind) + content


def heic_of(picture: Image.Image, *, quarter_turns: int = 0) -> bytes:
    """A picture in RGB with even sides, stored as turned clockwise so many quarters when shown."""
    codec = av.CodecContext.create("libx265", "w")
    assert isinstance(codec, av.VideoCodecContext)
    codec.width, codec.height, codec.pix_fmt = *picture.size, "yuv420p"
    codec.options = {"crf": "10", "x265-params": "log-level=0:repeat-headers=1"}
    frame = av.VideoFrame.from_image(picture)
    data = b"".join(bytes(p) for f in (frame, None) for p in codec.encode(f))
    units = [unit.removesuffix(b"\0") for unit in data.split(b"\0\0\1")[1:]]
    kinds = [unit[0] >> 1 & 63 for unit in units]
    sets = [(kind, unit) for kind, unit in zip(kinds, units, strict=True) if kind in (32, 33, 34)]
    image = b"".join(
        struct.pack(">I", len(u)) + u for k, u in zip(kinds, units, strict=True) if k < 32
    )
    profile = next(unit for kind, unit in sets if kind == 33).replace(b"\0\0\3", b"\0\0")[3:15]
    decoder = b"\1" + profile + b"\xf0\0\xfc\xfd\xf8\xf8\0\0\x0f" + bytes([len(sets)])
    decoder += b"".join(struct.pack(">BHH", k, 1, len(u)) + u for k, u in sets)
    properties = _box(
        b"ipco",
        _box(b"hvcC", decoder),
        _box(b"ispe", struct.pack(">II", *picture.size), version=0),
        _box(b"irot", bytes([-quarter_turns % 4])),
    )
    uses = _box(b"ipma", struct.pack(">IHB3B", 1, 1, 3, 0x81, 2, 0x83), version=0)
    kind = _box(b"ftyp", b"heic\0\0\0\0mif1heic")
    item = _box(b"infe", struct.pack(">HH4sB", 1, 0, b"hvc1", 0), version=2)

    def meta(at: int) -> bytes:
        return _box(
            b"meta",
            _box(b"hdlr", bytes(4), b"pict", bytes(13), version=0),
            _box(b"pitm", struct.pack(">H", 1), version=0),
            _box(b"iloc", struct.pack(">HHHHHII", 0x4400, 1, 1, 0, 1, at, len(image)), version=0),
            _box(b"iinf", struct.pack(">H", 1), item, version=0),
            _box(b"iprp", properties, uses),
            version=0,
        )

    return kind + meta(len(kind) + len(meta(0)) + 8) + _box(b"mdat", image)
