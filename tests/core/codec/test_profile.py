"""The tables of a stream: exact arithmetic, an unmistakable name, and nothing hostile comes in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import NUM_COMPONENTS, toy_profile
from pica_core.codec.profile import (
    MAX_LATENT,
    MAX_PAYLOAD_BYTES,
    TOTAL,
    TOTAL_BITS,
    StreamProfile,
    SymbolReader,
    Table,
    make_table,
    uniform,
    write_symbols,
)
from pica_core.errors import LatentError, ProfileError

pytestmark = pytest.mark.unit

NAMES = sorted(toy_profile().to_tensors())


def changed(name: str, array: np.ndarray[Any, Any]) -> dict[str, np.ndarray[Any, Any]]:
    return {**toy_profile().to_tensors(), f"stream.{name}": array}


def array_of(name: str) -> np.ndarray[Any, Any]:
    return toy_profile().to_tensors()[f"stream.{name}"].copy()


def with_value(name: str, place: tuple[int, ...], value: int) -> np.ndarray[Any, Any]:
    array = array_of(name)
    array[place] = value
    return array


def test_a_profile_comes_back_from_its_tensors() -> None:
    again = StreamProfile.from_tensors(toy_profile().to_tensors())
    assert again is not None
    for name, array in again.to_tensors().items():
        np.testing.assert_array_equal(array, array_of(name.removeprefix("stream.")))
    with pytest.raises(ValueError, match="read-only"):
        again.mean[0] = 0
    assert (again.num_components, again.num_coefficients) == (NUM_COMPONENTS, NUM_COMPONENTS + 6)


@pytest.mark.parametrize("name", NAMES)
def test_an_array_that_is_missing_or_of_another_type_or_shape_is_refused_by_name(name: str) -> None:
    tensors = toy_profile().to_tensors()
    array = tensors.pop(name)
    with pytest.raises(ProfileError, match=f"{name} is missing or unknown"):
        StreamProfile.from_tensors(tensors)
    big = array.dtype.newbyteorder(">")
    others = [array.astype(kind) for kind in (np.int64, np.float32, big) if array.dtype != kind]
    for wrong in (*others, array[:0], array[None], np.repeat(array, 300, axis=-1)):
        with pytest.raises(ProfileError, match=r"needed|rows"):
            StreamProfile.from_tensors({**tensors, name: wrong})


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("mean", with_value("mean", (3,), MAX_LATENT + 1), "mean spans"),
        ("synthesis_shift", np.array([25], np.int32), "0 to 24 is allowed"),
        ("synthesis_shift", np.array([-1], np.int32), "0 to 24 is allowed"),
        ("table_index", with_value("table_index", (4, 1), 121), "0 to 120 is allowed"),
    ],
)
def test_a_number_out_of_its_range_is_refused_by_name(
    name: str, array: np.ndarray[Any, Any], message: str
) -> None:
    with pytest.raises(ProfileError, match=rf"stream\.{message}|{message}"):
        StreamProfile.from_tensors(changed(name, array))


@st.composite
def tables(draw: st.DrawFn) -> Table:
    """Any table: a few cuts through the slots, some of them close together."""
    cuts = draw(st.sets(st.integers(1, TOTAL - 1), max_size=40))
    edges = [0, *sorted(cuts), TOTAL]
    return make_table(np.diff(edges))


@st.composite
def messages(draw: st.DrawFn) -> list[tuple[Table | int, int]]:
    """Symbols with their tables, and uniform numbers with their width in bits."""
    alphabets = draw(st.lists(tables(), min_size=1, max_size=3))
    message: list[tuple[Table | int, int]] = []
    for _ in range(draw(st.integers(0, 120))):
        if draw(st.booleans()):
            table = draw(st.sampled_from(alphabets))
            message.append((table, draw(st.integers(0, len(table.ranges) - 1))))
        else:
            num_bits = draw(st.integers(0, TOTAL_BITS))
            message.append((num_bits, draw(st.integers(0, 2**num_bits - 1))))
    return message


def write(message: list[tuple[Table | int, int]]) -> bytes:
    return write_symbols(
        uniform(value, kind) if isinstance(kind, int) else kind.ranges[value]
        for kind, value in message
    )


def information_bits(message: list[tuple[Table | int, int]]) -> float:
    return sum(
        kind if isinstance(kind, int) else -math.log2(kind.ranges[value][1] / TOTAL)
        for kind, value in message
    )


@settings(max_examples=60)
@given(message=messages())
def test_what_is_written_is_read_again_and_hardly_longer_than_what_it_says(
    message: list[tuple[Table | int, int]],
) -> None:
    payload = write(message)
    # Cutting the interval to 48 bits costs less than 0.01 bits in so many symbols.
    assert len(payload) <= (information_bits(message) + 0.01) / 8 + 1
    reader = SymbolReader(payload)
    read = [
        reader.read_uniform(kind) if isinstance(kind, int) else reader.read(kind)
        for kind, _ in message
    ]
    assert read == [value for _, value in message]
    reader.finish()


def test_the_slots_that_rounding_leaves_over_are_refused() -> None:
    # After a symbol of a third the interval is no multiple of 2^14: its end is nobody's.
    third = make_table([TOTAL // 3, TOTAL // 3, TOTAL - 2 * (TOTAL // 3)])
    reader = SymbolReader(b"\xff" * 40)

    def read_on() -> None:
        for _ in range(200):
            reader.read(third)

    with pytest.raises(LatentError, match="code that no encoder writes"):
        read_on()


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"\1" * (MAX_PAYLOAD_BYTES + 1), "has 513 bytes; the limit is 512"),
        (b"\1\0", "ends with a zero byte"),
        (b"\0", "ends with a zero byte"),
    ],
)
def test_a_payload_that_no_encoder_writes_is_refused_at_once(payload: bytes, message: str) -> None:
    with pytest.raises(LatentError, match=message):
        SymbolReader(payload)
