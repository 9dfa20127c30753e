"""The range coder: what is written is read again, and nothing hostile comes in."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pica_core.codec.range_coder import (
    MAX_PAYLOAD_BYTES,
    TOTAL,
    TOTAL_BITS,
    SymbolReader,
    Table,
    make_table,
    uniform,
    write_symbols,
)
from pica_core.errors import LatentError

pytestmark = pytest.mark.unit


@st.composite
def tables(draw: st.DrawFn) -> Table:
    """Any table: a few cuts through the slots, some of them close together."""
    cuts = draw(st.sets(st.integers(1, TOTAL - 1), max_size=40))
    edges = [0, *sorted(cuts), TOTAL]
    return make_table(np.diff(edges).tolist())


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
        (b"\1" * (MAX_PAYLOAD_BYTES + 1), "has 1281 bytes; the limit is 1280"),
        (b"\1\0", "ends with a zero byte"),
        (b"\0", "ends with a zero byte"),
    ],
)
def test_a_payload_that_no_encoder_writes_is_refused_at_once(payload: bytes, message: str) -> None:
    with pytest.raises(LatentError, match=message):
        SymbolReader(payload)
