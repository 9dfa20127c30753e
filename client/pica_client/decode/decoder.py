"""Latent -> position map and expression map, by ONNX Runtime.

An avatar is decoded to one of its levels, both maps or the expression map alone. Each of these is a
session of its own, built when it is first needed: a graph holds just what its outputs need.

Who computes is a setting: an execution provider by its name, with options that go to it as they
are. ONNX Runtime itself falls back to the CPU when a provider does not load; here that is an error,
for whoever asked for a GPU wants to know.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pica_client.decode.onnx_runtime import onnxruntime
from pica_client.decode.request import DecodedMaps, Parts
from pica_client.errors import OptionError, check_ranges
from pica_core.avatar.baseline import BaselineAvatar
from pica_core.avatar.file import Avatar
from pica_core.graphs.baseline_graph import baseline_graph
from pica_core.graphs.onnx_graph import decoder_graph
from pica_core.types import FloatArray

CPU_PROVIDER = "CPUExecutionProvider"


@dataclass(frozen=True, kw_only=True, slots=True)
class OnnxOptions:
    """How ONNX Runtime runs a decoder."""

    threads: int = 1
    """Threads per decode. One is best when several avatars share few cores (measured: a second
    thread makes block G slower, its layers are too small)."""
    provider: str = CPU_PROVIDER
    """ONNX Runtime execution provider, by its own name."""
    provider_options: Mapping[str, str] = field(default_factory=dict)
    """Options of the provider, handed on as they are."""

    def __post_init__(self) -> None:
        check_ranges(self, threads=(1, 64))

    @classmethod
    def for_provider(cls, text: str, threads: int = 1) -> OnnxOptions:
        """Read a provider as people write it: ``NAME`` or ``NAME:key=value,key=value``.

        Raises:
            OptionError: What follows the colon is not of that form.
        """
        name, _, rest = text.partition(":")
        pairs = [pair.partition("=") for pair in rest.split(",") if pair]
        if not name or not all(key and sign for key, sign, _ in pairs):
            raise OptionError(f"provider {text!r}; write NAME or NAME:key=value,key=value")
        options = {key: value for key, _, value in pairs}
        return cls(threads=threads, provider=name, provider_options=options)


def open_session(graph: bytes, options: OnnxOptions) -> Any:
    """An ``onnxruntime.InferenceSession`` that runs on the chosen provider.

    Raises:
        OptionError: The provider is not in this build of ONNX Runtime, does not load, or does not
            take its options or the graph.
    """
    available = onnxruntime.get_available_providers()
    if options.provider not in available:
        raise OptionError(
            f"provider {options.provider} is not in this ONNX Runtime; "
            f"available are {', '.join(available)}"
        )
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = options.threads
    settings.inter_op_num_threads = 1
    # Threads that spin between two decodes would take the cores from the rasteriser.
    settings.add_session_config_entry("session.intra_op.allow_spinning", "0")
    settings.log_severity_level = 3
    providers = [(options.provider, dict(options.provider_options))]
    try:
        session = onnxruntime.InferenceSession(graph, settings, providers=providers)
    except Exception as error:  # providers raise whatever their library raises
        raise OptionError(f"provider {options.provider} does not start: {error}") from error
    running = session.get_providers()
    if not running or running[0] != options.provider:
        raise OptionError(
            f"provider {options.provider} does not load here; ONNX Runtime would take "
            f"{', '.join(running) or 'none'} instead"
        )
    return session


class OnnxDecoder:
    """The per-object half of one avatar.

    Raises:
        OptionError: The provider is not in this build of ONNX Runtime, or does not start.
    """

    def __init__(self, avatar: Avatar, options: OnnxOptions | None = None) -> None:
        self._avatar = avatar
        self._options = options or OnnxOptions()
        self._sessions: dict[tuple[int, Parts], Any] = {}  # at most two per level
        self.prepare()

    def prepare(self, level: int | None = None, parts: Parts = "both") -> Any:
        """Get ready for such decodes; may take long, once. Gives their session; OptionError if they
        cannot be had."""
        size = self._avatar.spec.map_size if level is None else level
        session = self._sessions.get((size, parts))
        if session is None:
            if size not in self._avatar.levels:
                known = ", ".join(map(str, self._avatar.levels))
                raise OptionError(f"level is {size}; this avatar has {known}")
            graph = decoder_graph(self._avatar, level=size, parts=parts)
            session = self._sessions[size, parts] = open_session(graph, self._options)
        return session

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


@dataclass(frozen=True, slots=True, eq=False)
class DecodedBaseline:
    """What the baseline makes of one latent."""

    vertices_m: FloatArray
    """Head-frame metres, float32 ``[V, 3]``."""
    texture: FloatArray
    """RGB, 1.0 is white, row 0 is v = 0. float32 ``[T, T, 3]``."""


class BaselineDecoder:
    """The paper's baseline, for comparison: one network for vertices and the whole texture."""

    def __init__(self, avatar: BaselineAvatar, options: OnnxOptions | None = None) -> None:
        self._session = open_session(baseline_graph(avatar), options or OnnxOptions())

    def decode(self, latent: FloatArray, view_direction: FloatArray) -> DecodedBaseline:
        """Decode one latent of 256 numbers in any shape, as seen along `view_direction` ``[3]``."""
        feeds = {"latent": latent.reshape(1, -1), "view_direction": view_direction[None]}
        vertices_m, texture = self._session.run(["vertices", "texture"], feeds)
        return DecodedBaseline(vertices_m, texture)
