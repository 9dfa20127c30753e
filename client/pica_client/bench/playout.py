"""What the receiver's playout makes of a troubled network, in the unit that counts: the error of
the rendered face. On a virtual clock, so every figure comes out the same on every machine with the
same renderer.

A row is one scenario under one policy; figures are of the troubled third of the run. The error is
against the true face at the moment that the policy means to show, with the head where it truly was.
What it does not show: real networks (see `network.impairment` for what is modelled), displays that
miss refreshes, and people: performances and avatars are synthetic.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from pica_client.bench.harness import Words, check_names, report
from pica_client.bench.head import FaceRenderer
from pica_client.bench.network.impairment import BY_NAME, SCENARIOS
from pica_client.bench.network.stream_trial import Delivery, Face, Schedule, Tick, deliver, play
from pica_client.errors import OptionError, check_ranges
from pica_client.output import say
from pica_client.playout.buffer import Playout, PlayoutConfig
from pica_client.render.drawing import Drawing, drawn_mse
from pica_client.sources import open_source
from pica_client.stats import percentile
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, LatentSample, StreamConfig

SIZE_PX = 192
MAX_DRAWINGS = 1500
"""Drawings of the true face kept: 0.15 MB each."""
ADAPTIVE = PlayoutConfig()
"""What receivers use."""
FIXED = replace(ADAPTIVE, floor_s=0.1, floor_intervals=0.0, ceiling_s=0.1)
"""Always 100 ms behind the fastest frame; moves and conceals as ADAPTIVE does."""
POLICIES = {"adaptive": ADAPTIVE, "fixed": FIXED}


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchPlayoutConfig:
    """What to compare."""

    source: str = "performance:talk"
    """The face that is sent; see pica send --help."""
    scenarios: Words = ()
    """Names of troubles, separated by commas; all by default."""
    schedule: Annotated[Schedule, Parameter(name="*")] = field(default_factory=Schedule)
    """When frames are captured and shown."""
    renders_per_s: float = 10.0
    """Refreshes that are rendered to measure the error, a second."""
    seed: int = 0
    """Seed of the network."""

    def __post_init__(self) -> None:
        check_ranges(self, renders_per_s=(0.5, self.schedule.display_hz), seed=(0, 2**32))
        check_names("scenario", self.scenarios, BY_NAME)


def open_ends(avatar: Avatar, fps: float) -> tuple[LatentEncoder, LatentDecoder]:
    """Both ends of a stream of an avatar, fresh.

    Raises:
        ProfileError: The avatar has no stream profile.
    """
    profile = avatar.stream_profile()
    return LatentEncoder(profile, StreamConfig(fps=fps)), LatentDecoder(profile)


def run_bench_playout(config: BenchPlayoutConfig, avatar: Avatar) -> dict[str, Any]:
    """Run all scenarios under all policies.

    Raises:
        ClientError: A source that cannot be read.
        GraphicsError: No GL context; names the fix.
    """
    face = true_face(config.source, avatar)
    chosen = [BY_NAME[name] for name in config.scenarios] or list(SCENARIOS)
    rows = []
    with FaceRenderer(avatar, size_px=SIZE_PX, views=("front",)) as renderer:
        compare = _Comparison(renderer, face, config.schedule, config.renders_per_s)
        for scenario in chosen:
            ends = open_ends(avatar, config.schedule.fps)
            delivery = deliver(face, ends, scenario, config.schedule, seed=config.seed)
            for policy, playout in POLICIES.items():
                ticks = play(delivery, Playout(playout), config.schedule)
                rows.append(
                    {
                        "scenario": scenario.name,
                        "policy": policy,
                        "source": config.source,
                        **compare(ticks, delivery),
                        **_network(delivery, config.schedule),
                    }
                )
            say(f"{scenario.name}: {scenario.note}")
    return report(config, rows, avatar=avatar.manifest.name)


def true_face(source: str, avatar: Avatar) -> Face:
    """The face that a source shows, as a function of time.

    Raises:
        SourceError: It cannot be read.
    """
    opened, encoder = open_source(source), ExpressionEncoder(avatar)

    def face(time_s: float) -> LatentSample:
        frame = opened.frame_at(time_s)
        return LatentSample(
            latent=encoder.encode(frame.arkit),
            rotation=frame.rotation,
            translation_m=frame.translation_m,
        )

    return face


class _Comparison:
    """Compares what was shown with the true face. Draws the true face of a moment once."""

    def __init__(
        self, renderer: FaceRenderer, face: Face, schedule: Schedule, renders_per_s: float
    ) -> None:
        self._renderer = renderer
        self._face = face
        self._schedule = schedule
        self._every = max(round(schedule.display_hz / renders_per_s), 1)
        self._true_drawing = lru_cache(maxsize=MAX_DRAWINGS)(self._draw_true)

    def __call__(self, ticks: Sequence[Tick], delivery: Delivery) -> dict[str, Any]:
        """The figures of one run; see the module."""
        schedule = self._schedule
        troubled = [tick for tick in ticks if schedule.begin_s <= tick.now_s < schedule.end_s]
        added_s = sorted(_added_delay_s(tick, delivery) for tick in troubled)
        errors = [self._error(tick, delivery) for tick in troubled[:: self._every]]
        late = [tick.report.late for tick in (troubled[0], troubled[-1])]
        return {
            "mse": round(float(np.mean(errors)), 3),
            "added_delay_ms_p50": round(percentile(added_s, 50) * 1e3, 1),
            "added_delay_ms_p95": round(percentile(added_s, 95) * 1e3, 1),
            "concealed_ratio": round(float(np.mean([_is_concealed(tick) for tick in troubled])), 4),
            "longest_gap_ms": self._longest_gap_ms(troubled),
            "late": late[1] - late[0],
        }

    def _error(self, tick: Tick, delivery: Delivery) -> float:
        """One refresh's error."""
        if tick.played is None:
            raise OptionError("nothing is shown in the troubled third; let the run be longer")
        meant_us = round((tick.now_s - delivery.base_delay_s - tick.report.delay_s) * 1e6)
        pose = self._face(meant_us / 1e6)
        shown = self._renderer.draw(tick.played.sample.latent, pose.rotation, pose.translation_m)
        return drawn_mse(shown, self._true_drawing(meant_us))

    def _longest_gap_ms(self, ticks: Sequence[Tick]) -> float:
        runs = itertools.groupby(ticks, key=_is_concealed)
        longest = max((sum(1 for _ in run) for is_gap, run in runs if is_gap), default=0)
        return round(longest / self._schedule.display_hz * 1e3, 1)

    def _draw_true(self, time_us: int) -> Drawing:
        return self._renderer.draw_sample(self._face(time_us / 1e6))


def _network(delivery: Delivery, schedule: Schedule) -> dict[str, Any]:
    return {
        **delivery.counts,
        "decoded": len(delivery.arrivals),
        "payload_bps": round(delivery.payload_bytes * 8 / schedule.seconds),
        "wire_bps": round(delivery.wire_bytes * 8 / schedule.seconds),
    }


def _added_delay_s(tick: Tick, delivery: Delivery) -> float:
    """Age of the face beyond the fastest transit; that of the whole run before the first face."""
    if tick.played is None:
        return tick.now_s
    return tick.now_s - tick.shown_s - delivery.base_delay_s


def _is_concealed(tick: Tick) -> bool:
    return tick.played is None or tick.played.is_concealed
