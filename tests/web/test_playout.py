"""The page plays a stream out as the Python client does, at every moment."""

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from helpers.page import Page
from pica_client.playout.buffer import Playout
from pica_core.codec.latent_stream import LatentSample
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

FPS = 30
DRAWS = st.sampled_from([1 / 60, 1 / 30, 0.11])
"""Seconds between two pictures: faster than the frames come, as fast, slower."""


def _face(number: int, *, is_still: bool) -> LatentSample:
    rng = np.random.default_rng(number)
    latent = rng.standard_normal((8, 8, 4)).astype(np.float32)
    rotation, translation = rng.standard_normal((2, 3)).astype(np.float32)
    return LatentSample(
        latent=latent, rotation=rotation, translation_m=translation, is_still=is_still
    )


def _flat(face: LatentSample) -> np.ndarray:
    return np.concatenate([face.latent.ravel(), face.rotation, face.translation_m])


@settings(
    max_examples=12,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    delays_s=st.lists(st.floats(0.0, 0.3), min_size=15, max_size=40),
    fates=st.lists(
        st.sampled_from(["come"] * 12 + ["lost", "still", "rest", "again"]), min_size=60
    ),
    step_s=DRAWS,
    voice=st.sampled_from([None, 0.05, 0.12]),
)
def test_every_picture_is_that_of_python(
    page: Page, delays_s: list[float], fates: list[str], step_s: float, voice: float | None
) -> None:
    arrivals, captured_us, sequence, at_s, rested_s = [], 5_000_000, 65_520, 0.0, 0.0
    for number, (delay_s, fate) in enumerate(zip(delays_s, fates, strict=False)):
        if fate == "again":  # the sender has started again: another clock, other numbers
            captured_us, sequence = 1_000_000, 3
        at_s = max(at_s, number / FPS + rested_s + delay_s)  # nothing overtakes on a websocket
        frame = Frame(
            stream=1, sequence=sequence % 65_536, captured_us=captured_us, payload=b"face"
        )
        if fate != "lost":
            arrivals.append((at_s, frame, _face(number, is_still=fate in ("still", "rest"))))
        captured_us, sequence = captured_us + 1_000_000 // FPS, sequence + 1
        if fate == "rest":
            rested_s, captured_us = rested_s + 0.6, captured_us + 600_000
    python, browser = Playout(), page.call("playout", "Playout")
    for picture in range(int((len(delays_s) / FPS + rested_s + 0.6) / step_s)):
        now = 100 + picture * step_s
        while arrivals and arrivals[0][0] + 100 <= now:
            arrived_s, frame, face = arrivals.pop(0)
            python.receive(frame, face, arrived_s + 100)
            browser.receive(
                {"sequence": frame.sequence, "capturedUs": frame.captured_us},
                {"values": _flat(face), "isStill": face.is_still},
                arrived_s + 100,
            )
        heard_us = None if voice is None else round((now - 100 - voice) * 1e6) + 5_000_000
        expected, found = python.sample_at(now, heard_us), browser.sampleAt(now, heard_us)
        assert (expected is None) == (found is None)
        if expected is not None:
            assert found == pytest.approx(_flat(expected.sample), abs=1e-4)
