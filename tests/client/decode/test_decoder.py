"""Decoding on worker threads: newest first, bounded, and one broken avatar harms no other."""

import os
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode import decoder
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, num_workers
from pica_client.decode.request import DecodedMaps, DecodeRequest, Parts
from pica_client.errors import OptionError
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import AvatarSpec

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=4)
LEVELLED = with_toy_levels(TOY)
LEVELS = LEVELLED.levels
AHEAD = np.array([0, 0, 1], np.float32)
PATIENCE_S = 20.0


def request(
    value: float, captured_us: int = 0, level: int | None = None, parts: Parts = "both"
) -> DecodeRequest:
    latent = np.full((8, 8, 4), value, np.float32)
    return DecodeRequest(latent, AHEAD, captured_us, level, parts)


class Echo:
    """A decoder that hands its latent back, and notes what was asked of it."""

    def __init__(self) -> None:
        self.num_ahead = 0
        self.decoded: list[tuple[float, Parts]] = []

    def prepare(self, level: int | None = None, parts: Parts = "both") -> None:
        """It needs nothing."""

    def has(self, level: int | None, parts: Parts) -> bool:
        return True

    def prepare_next(self) -> bool:
        self.num_ahead += 1
        return self.num_ahead < 3

    def decode(
        self, latent: np.ndarray, view_direction: np.ndarray, level: int | None, parts: Parts
    ) -> DecodedMaps:
        self.decoded.append((float(latent[0, 0, 0]), parts))
        return DecodedMaps(latent if parts == "both" else None, latent, level or 256)


class Gate(Echo):
    """A decoder that waits until the test opens it."""

    def __init__(self) -> None:
        super().__init__()
        self.opened = threading.Event()
        self.entered = threading.Event()

    def decode(self, *arguments: Any) -> DecodedMaps:
        self.entered.set()
        assert self.opened.wait(PATIENCE_S)
        return super().decode(*arguments)


class Broken(Echo):
    """A decoder that fails."""

    def decode(self, *arguments: Any) -> DecodedMaps:
        raise RuntimeError("the driver\nwent away")


@pytest.mark.parametrize("level", LEVELS)
def test_every_level_is_decoded_to_maps_of_its_size(level: int) -> None:
    decoder = OnnxDecoder(LEVELLED)
    latent = np.random.default_rng(level).standard_normal((8, 8, 4)).astype(np.float32)
    maps = decoder.decode(latent, AHEAD, level)
    assert maps.position_map is not None
    assert maps.position_map.shape == (LEVELLED.position_rows(level), level, 3)
    assert maps.expression_map.shape == (level, level, 4)
    assert maps.position_map.flags.c_contiguous
    assert maps.level == level
    alone = decoder.decode(latent, AHEAD, level, "expression")
    assert alone.position_map is None
    np.testing.assert_allclose(alone.expression_map, maps.expression_map, atol=1e-5)


def test_a_level_that_the_avatar_lacks_is_named_with_those_that_it_has() -> None:
    with pytest.raises(OptionError, match=r"level is 100; this avatar has .*256"):
        OnnxDecoder(TOY).decode(np.zeros((8, 8, 4), np.float32), AHEAD, 100)


def test_a_decoder_gets_ready_for_every_level_the_finest_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[bytes] = []
    monkeypatch.setattr(decoder, "open_session", lambda graph, _: opened.append(graph) or graph)
    monkeypatch.setattr(decoder, "decoder_graph", lambda _, level, positions: (level, positions))
    made = OnnxDecoder(LEVELLED)
    while made.prepare_next():
        pass
    assert opened == [(level, both) for level in LEVELS[::-1] for both in (True, False)]


def test_a_pool_decodes_every_avatar_and_hands_the_capture_time_through() -> None:
    with DecodePool(OnnxDecoder, workers=2) as pool:
        for index in range(3):
            pool.add(f"peer-{index}", TOY)
            pool.submit(f"peer-{index}", request(0.1 * index, captured_us=1000 + index))
        assert pool.wait_idle(PATIENCE_S)
        results = {result.slot: result for result in pool.take_results()}
    times_us = {slot: result.captured_us for slot, result in results.items()}
    assert times_us == {f"peer-{index}": 1000 + index for index in range(3)}
    assert all(result.maps is not None and result.error is None for result in results.values())
    assert all(result.decode_s > 0 and result.waited_s >= 0 for result in results.values())


def test_while_a_decode_runs_the_newest_request_waits_and_asks_for_what_it_replaces() -> None:
    gate = Gate()
    with DecodePool(lambda avatar: gate) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1, parts="expression"))
        assert gate.entered.wait(PATIENCE_S)
        for value, parts in ((2, "expression"), (3, "both"), (4, "expression")):
            pool.submit("a", request(value, parts=parts))
        gate.opened.set()
        assert pool.wait_idle(PATIENCE_S)
    assert gate.decoded == [(1, "expression"), (4, "both")]
    assert pool.num_replaced == 2


def test_results_that_nobody_has_taken_yet_come_once_and_in_order() -> None:
    with DecodePool(lambda avatar: Echo()) as pool:
        pool.add("a", TOY)
        for number, parts in ((1, "both"), (2, "expression")):
            pool.submit("a", request(number, captured_us=number, parts=parts))
            assert pool.wait_idle(PATIENCE_S)
        found = [(result.captured_us, result.parts) for result in pool.take_results()]
        assert found == [(1, "both"), (2, "expression")]
        assert pool.take_results() == []


@pytest.mark.parametrize("step", ["has", "prepare_next"])
def test_faces_are_decoded_while_sessions_of_another_avatar_are_built(step: str) -> None:
    """Building takes as long as a few images."""

    class Slow(Gate):
        def prepare(self, level: int | None = None, parts: Parts = "both") -> None:
            if step == "has":
                self.wait()

        def has(self, level: int | None, parts: Parts) -> bool:
            return step != "has" or self.opened.is_set()

        def prepare_next(self) -> bool:
            self.wait()
            return super().prepare_next()

        def wait(self) -> None:
            self.entered.set()
            assert self.opened.wait(PATIENCE_S)

    slow, echo = Slow(), Echo()
    decoders = iter([echo, slow])
    with DecodePool(lambda avatar: next(decoders)) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert pool.wait_idle(PATIENCE_S)
        pool.add("slow", TOY)
        if step == "has":
            pool.submit("slow", request(2))
        assert slow.entered.wait(PATIENCE_S)
        pool.submit("a", request(3))
        while [value for value, _ in echo.decoded] != [1, 3]:
            assert not slow.opened.wait(0.01)
        slow.opened.set()
        assert pool.wait_idle(PATIENCE_S)
    assert [value for value, _ in slow.decoded] == ([2] if step == "has" else [])


def test_sessions_of_all_levels_are_built_before_they_are_asked_for() -> None:
    decoders = [Echo(), Echo()]
    with DecodePool(lambda avatar: decoders[avatar is LEVELLED]) as pool:
        for slot, avatar in (("a", TOY), ("b", LEVELLED)):
            pool.add(slot, avatar)
        for _ in range(round(PATIENCE_S / 0.01)):
            if (done := [echo.num_ahead for echo in decoders]) == [3, 3]:
                break
            time.sleep(0.01)
    assert done == [3, 3]


def test_building_a_session_does_not_count_as_decoding() -> None:
    times = iter(range(1000))

    class Slow(Echo):
        def prepare(self, level: int | None = None, parts: Parts = "both") -> None:
            for _ in range(100):
                next(times)

    with DecodePool(lambda avatar: Slow(), lambda: next(times)) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert pool.wait_idle(PATIENCE_S)
        (result,) = pool.take_results()
    assert result.decode_s == 1


def test_one_avatar_is_never_decoded_by_two_workers_at_once() -> None:
    gate = Gate()
    with DecodePool(lambda avatar: gate, workers=4) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert gate.entered.wait(PATIENCE_S)
        gate.entered.clear()
        pool.submit("a", request(2))
        pool.add("b", TOY)  # another slot is served meanwhile
        pool.submit("b", request(3))
        assert gate.entered.wait(PATIENCE_S)
        gate.opened.set()
        assert pool.wait_idle(PATIENCE_S)
    order = [value for value, _ in gate.decoded]
    assert sorted(order) == [1, 2, 3]
    assert order.index(1) < order.index(2)


def test_a_broken_avatar_is_reported_and_the_others_decode_on() -> None:
    decoders = iter([Broken(), Echo()])
    with DecodePool(lambda avatar: next(decoders)) as pool:
        pool.add("bad", TOY)
        pool.submit("bad", request(1))
        assert pool.wait_idle(PATIENCE_S)
        pool.add("good", TOY)
        pool.submit("good", request(2))
        pool.submit("bad", request(3))
        assert pool.wait_idle(PATIENCE_S)
        results = {result.slot: result for result in pool.take_results()}
    assert results["bad"].maps is None
    assert results["bad"].error == "the driver went away"
    assert results["good"].maps is not None


def test_an_avatar_whose_decoder_cannot_be_built_is_reported_without_a_request() -> None:
    def refuse(avatar: Avatar) -> Echo:
        raise OptionError("does not start")

    with DecodePool(refuse) as pool:
        pool.add("a", TOY)
        assert pool.wait_idle(PATIENCE_S)
        (result,) = pool.take_results()
    assert result.error == "does not start"


def test_a_removed_avatar_leaves_nothing_behind() -> None:
    gate = Gate()
    with DecodePool(lambda avatar: gate) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert gate.entered.wait(PATIENCE_S)
        pool.remove("a")
        pool.remove("never-there")
        gate.opened.set()
        pool.submit("a", request(2))
        assert pool.wait_idle(PATIENCE_S)
        assert pool.take_results() == []


def test_closing_drops_what_waits_and_ends_the_threads() -> None:
    before = threading.active_count()
    pool = DecodePool(lambda avatar: Echo(), workers=3)
    pool.add("a", TOY)
    pool.close()
    assert threading.active_count() == before


@pytest.mark.parametrize(
    ("num_cores", "wanted"), [(None, 1), (1, 1), (2, 1), (8, 2), (16, 4), (96, 4)]
)
def test_few_of_the_cores_decode(num_cores: int | None, wanted: int) -> None:
    assert num_workers(num_cores) == wanted


@pytest.mark.parametrize(("given", "expected"), [(None, "1"), ("0", "0")])
def test_telemetry_is_off_unless_the_user_has_set_otherwise(
    given: str | None, expected: str
) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("ORT_")}
    if given is not None:
        environment["ORT_DISABLE_TELEMETRY"] = given
    # A stand-in for the library: with telemetry on, the real one would reach for the network.
    script = """
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "onnxruntime":
            print(os.environ.get("ORT_DISABLE_TELEMETRY"))
            sys.exit()
sys.meta_path.insert(0, Finder())
import pica_client.decode.decoder
"""
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [expected]
