"""What drawing a call costs, in counts: the same on every machine, whatever else it does.

A scheduler that never measures plans by expected costs, and decodes run at once on this thread.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

import moderngl

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult
from pica_client.render.renderer import Renderer
from pica_client.render.room import EMPTY_ROOM, Room
from pica_client.render.scene import Placement
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera

DECODE_S = 0.001
"""What every decode is said to take."""


class CountedPool:
    """Stands for `DecodePool`: decodes when its results are taken.

    Attributes:
        num_decodes: Decodes so far; those of the expression map alone count one half.
    """

    def __init__(self) -> None:
        self.num_decodes = 0.0
        self._decoders: dict[str, OnnxDecoder] = {}
        self._requests: dict[str, DecodeRequest] = {}

    def add(self, slot: str, avatar: Avatar) -> None:
        self._decoders[slot] = OnnxDecoder(avatar)

    def remove(self, slot: str) -> None:
        self._decoders.pop(slot, None)
        self._requests.pop(slot, None)

    def submit(self, slot: str, request: DecodeRequest) -> None:
        self._requests[slot] = request

    def take_results(self) -> list[DecodeResult]:
        results = []
        for slot, asked in self._requests.items():
            wanted = asked.latent, asked.view_direction, asked.level, asked.parts
            maps = self._decoders[slot].decode(*wanted)
            self.num_decodes += 1.0 if asked.parts == "both" else 0.5
            results.append(
                DecodeResult(
                    slot,
                    maps,
                    None,
                    captured_us=asked.captured_us,
                    finished_s=DECODE_S,
                    parts=asked.parts,
                )
            )
        self._requests.clear()
        return results


class CountedRenderer(Renderer):
    """A renderer that adds up what it draws; `counts` are means over the images."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        super().__init__(context, size)
        self._sums: Counter[str] = Counter()
        self._num_images = 0

    def update_maps(self, slot: str, *maps: Any) -> None:
        before = self.bytes_uploaded(slot)
        with calls_counted(self._sums):
            super().update_maps(slot, *maps)
        self._sums["bytes_uploaded"] += self.bytes_uploaded(slot) - before

    def count(
        self, placements: Sequence[Placement], camera: Camera, room: Room = EMPTY_ROOM
    ) -> None:
        """Draw an image and count it."""
        with calls_counted(self._sums):
            stats = self.draw(placements, camera, room=room, count_pixels=True)
        self._num_images += 1
        self._sums["triangles"] += stats.num_triangles
        self._sums["decoded_pixels"] += stats.shaded_pixels or 0
        self._sums["textured_texels"] += stats.textured_pixels or 0

    def counts(self, pool: CountedPool) -> dict[str, float]:
        """Everything so far, an image."""
        sums = {"textured_texels": 0, **self._sums, "decodes": pool.num_decodes}
        return {name: round(total / self._num_images, 2) for name, total in sums.items()}


@contextmanager
def calls_counted(sums: Counter[str]) -> Iterator[None]:
    """Count calls into the GL binding under ``gl_calls``."""

    def on_event(_frame: FrameType, event: str, function: Any) -> None:
        if event == "c_call":
            owner = type(getattr(function, "__self__", None))
            sums["gl_calls"] += owner.__module__ == "mgl"

    before = sys.getprofile()
    sys.setprofile(on_event)
    try:
        yield
    finally:
        sys.setprofile(before)
