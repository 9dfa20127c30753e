"""Latent -> position map and expression map, by ONNX Runtime on the CPU.

An avatar is decoded to one of its levels, both maps or the expression map alone. Each of these is a
session of its own, built when it is first needed: a graph holds just what its outputs need.

This is the one module that imports ONNX Runtime. The official builds of 1.29 and later send usage
events to their maker and keep an identifier of the machine in the user's cache folder. Both are off
when ``ORT_DISABLE_TELEMETRY`` is 1 before the first import; a value that is set already stays.
"""

from __future__ import annotations

import os
from typing import Any, get_args

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

import onnxruntime as onnxruntime

from pica_client.decode.request import DecodedMaps, Parts
from pica_client.errors import OptionError
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import MAP_SIZE
from pica_core.graphs import baseline_graph, decoder_graph
from pica_core.reference import BaselineAvatar
from pica_core.types import FloatArray


def open_session(graph: bytes, threads: int) -> Any:
    """An ``onnxruntime.InferenceSession``."""
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = threads
    settings.inter_op_num_threads = 1
    # Threads that spin between two decodes would take the cores from the rasteriser.
    settings.add_session_config_entry("session.intra_op.allow_spinning", "0")
    settings.log_severity_level = 3
    return onnxruntime.InferenceSession(graph, settings, providers=["CPUExecutionProvider"])


class OnnxDecoder:
    """The per-object half of one avatar.

    Args:
        threads: Per decode. One is best when several avatars share few cores (measured: a second
            thread makes block G slower, its layers are too small).
    """

    def __init__(self, avatar: Avatar, threads: int = 1) -> None:
        self._avatar, self._threads = avatar, threads
        self._sessions: dict[tuple[int, Parts], Any] = {}  # at most two per level
        self.prepare()

    def prepare(self, level: int | None = None, parts: Parts = "both") -> Any:
        """Get ready for such decodes; may take long, once. Gives their session; OptionError for a
        level that the avatar lacks."""
        size = MAP_SIZE if level is None else level
        session = self._sessions.get((size, parts))
        if session is None:
            if size not in self._avatar.levels:
                known = ", ".join(map(str, self._avatar.levels))
                raise OptionError(f"level is {size}; this avatar has {known}")
            graph = decoder_graph(self._avatar, level=size, positions=parts == "both")
            session = self._sessions[size, parts] = open_session(graph, self._threads)
        return session

    def has(self, level: int | None, parts: Parts) -> bool:
        """Whether `prepare` for such decodes takes no time."""
        return (MAP_SIZE if level is None else level, parts) in self._sessions

    def prepare_next(self) -> bool:
        """Get ready for one more kind of decode, the finest first; return whether there was one."""
        kinds: list[tuple[int, Parts]] = [
            (level, parts) for level in reversed(self._avatar.levels) for parts in get_args(Parts)
        ]
        missing = [kind for kind in kinds if kind not in self._sessions]
        if missing:
            self.prepare(*missing[0])
        return bool(missing)

    def decode(
        self,
        latent: FloatArray,
        view_direction: FloatArray,
        level: int | None = None,
        parts: Parts = "both",
    ) -> DecodedMaps:
        """Decode one latent ``[8, 8, 4]`` as seen along the unit vector `view_direction` ``[3]`` to
        maps of a level; None is the full one."""
        session = self.prepare(level, parts)
        feeds = {"latent": latent[None], "view_direction": view_direction[None]}
        if parts == "both":
            position_map, expression_map = session.run(["position_map", "expression_map"], feeds)
            return DecodedMaps(position_map, expression_map, len(expression_map))
        (expression_map,) = session.run(["expression_map"], feeds)
        return DecodedMaps(None, expression_map, len(expression_map))


class BaselineDecoder:
    """The paper's baseline, for comparison: one network for vertices and the whole texture."""

    def __init__(self, avatar: BaselineAvatar, threads: int = 1) -> None:
        self._session = open_session(baseline_graph(avatar), threads)

    def decode(
        self, latent: FloatArray, view_direction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Decode one latent of 256 numbers in any shape, as seen along `view_direction` ``[3]``.

        Returns:
            Vertices in head-frame metres, float32 ``[V, 3]``; the RGB texture, where 1.0 is white
            and row 0 is v = 0, float32 ``[T, T, 3]``.
        """
        feeds = {"latent": latent.reshape(1, -1), "view_direction": view_direction[None]}
        vertices_m, texture = self._session.run(["vertices", "texture"], feeds)
        return vertices_m, texture
