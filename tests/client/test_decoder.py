"""Decoding on worker threads: newest first, bounded, and one broken avatar harms no other."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from pica_client.decoder import (
    DecodedMaps,
    DecodePool,
    DecodePoolOptions,
    DecodeRequest,
    OnnxDecoder,
    OnnxOptions,
)
from pica_client.errors import OptionError
from pica_core.avatar_file import Avatar
from pica_core.spec import AvatarSpec
from toy import make_toy_avatar

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=4)
AHEAD = np.array([0, 0, 1], np.float32)
PATIENCE_S = 20.0


def request(value: float, captured_us: int = 0) -> DecodeRequest:
    return DecodeRequest(np.full((8, 8, 4), value, np.float32), AHEAD, captured_us)


class Gate:
    """A decoder that waits until the test opens it, and notes what it decoded."""

    def __init__(self, avatar: Avatar) -> None:
        self.opened = threading.Event()
        self.entered = threading.Event()
        self.decoded: list[float] = []

    def decode(self, latent: np.ndarray, view_direction: np.ndarray) -> DecodedMaps:
        self.entered.set()
        assert self.opened.wait(PATIENCE_S)
        self.decoded.append(float(latent[0, 0, 0]))
        return DecodedMaps(latent, latent)


class Broken:
    """A decoder that fails."""

    def decode(self, latent: np.ndarray, view_direction: np.ndarray) -> DecodedMaps:
        raise RuntimeError("the driver\nwent away")


class Echo:
    """A decoder that hands its latent back."""

    def decode(self, latent: np.ndarray, view_direction: np.ndarray) -> DecodedMaps:
        return DecodedMaps(latent, latent)


def test_a_decoder_turns_a_latent_into_two_maps() -> None:
    maps = OnnxDecoder(TOY).decode(np.zeros((8, 8, 4), np.float32), AHEAD)
    assert maps.position_map.shape == (256, 256, 3)
    assert maps.expression_map.shape == (256, 256, 4)
    assert maps.position_map.flags.c_contiguous
    assert maps.expression_map.dtype == np.float32


def test_a_provider_that_is_not_there_is_named_with_those_that_are() -> None:
    with pytest.raises(OptionError, match=r"NoSuchProvider is not .* available are .*CPU"):
        OnnxDecoder(TOY, OnnxOptions(provider="NoSuchProvider"))


@pytest.mark.parametrize("options", [OnnxOptions, DecodePoolOptions])
def test_no_threads_are_refused(options: type) -> None:
    name = "threads" if options is OnnxOptions else "workers"
    with pytest.raises(OptionError, match=f"{name} is 0; allowed are 1 to 64"):
        options(**{name: 0})


def test_a_pool_decodes_every_avatar_and_hands_the_capture_time_through() -> None:
    with DecodePool(DecodePoolOptions(workers=2), OnnxDecoder) as pool:
        for index in range(3):
            pool.add(f"peer-{index}", TOY)
            pool.submit(f"peer-{index}", request(0.1 * index, captured_us=1000 + index))
        assert pool.wait_idle(PATIENCE_S)
        results = {result.slot: result for result in pool.take_results()}
    assert {slot: result.captured_us for slot, result in results.items()} == {
        "peer-0": 1000,
        "peer-1": 1001,
        "peer-2": 1002,
    }
    assert all(result.maps is not None and result.error is None for result in results.values())
    assert all(result.decode_s > 0 and result.waited_s >= 0 for result in results.values())


def test_a_result_is_handed_out_once() -> None:
    with DecodePool(DecodePoolOptions(), lambda avatar: Echo()) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert pool.wait_idle(PATIENCE_S)
        assert len(pool.take_results()) == 1
        assert pool.take_results() == []


def test_while_a_decode_runs_only_the_newest_request_waits() -> None:
    gate = Gate(TOY)
    with DecodePool(DecodePoolOptions(), lambda avatar: gate) as pool:
        pool.add("a", TOY)
        pool.submit("a", request(1))
        assert gate.entered.wait(PATIENCE_S)
        for value in (2, 3, 4):
            pool.submit("a", request(value))
        gate.opened.set()
        assert pool.wait_idle(PATIENCE_S)
        assert gate.decoded == [1, 4]
        assert pool.num_replaced == 2


def test_one_avatar_is_never_decoded_by_two_workers_at_once() -> None:
    gate = Gate(TOY)
    with DecodePool(DecodePoolOptions(workers=4), lambda avatar: gate) as pool:
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
    assert sorted(gate.decoded) == [1, 2, 3]
    assert gate.decoded.index(1) < gate.decoded.index(2)


def test_a_broken_avatar_is_reported_and_the_others_decode_on() -> None:
    decoders = iter([Broken(), Echo()])
    with DecodePool(DecodePoolOptions(), lambda avatar: next(decoders)) as pool:
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
        raise OptionError("provider X does not start")

    with DecodePool(DecodePoolOptions(), refuse) as pool:
        pool.add("a", TOY)
        assert pool.wait_idle(PATIENCE_S)
        (result,) = pool.take_results()
    assert result.error == "provider X does not start"


def test_a_removed_avatar_leaves_nothing_behind() -> None:
    gate = Gate(TOY)
    with DecodePool(DecodePoolOptions(), lambda avatar: gate) as pool:
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
    pool = DecodePool(DecodePoolOptions(workers=3), lambda avatar: Echo())
    pool.add("a", TOY)
    pool.close()
    assert threading.active_count() == before
