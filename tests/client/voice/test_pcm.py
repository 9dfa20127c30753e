"""Sound that another program writes becomes a voice, silent where it writes nothing."""

import asyncio
import io
import os

import numpy as np
import pytest

from pica_client.cli.send import AgentOptions, agent
from pica_client.errors import OptionError, SourceError
from pica_client.voice.pcm import TAIL_FRAMES, PcmSource
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


async def _played(source: PcmSource) -> FloatArray:
    frames = [pcm async for pcm, _ in source.frames(asyncio.Event())]
    return np.concatenate(frames)


@pytest.mark.parametrize("rate_hz", [16_000, 48_000])
def test_what_is_written_is_played_to_its_end(rate_hz: int) -> None:
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(rate_hz // 4) / rate_hz)
    data = np.round(tone * 32767).astype("<i2").tobytes() + b"\1"  # and half a sample
    sound = asyncio.run(_played(PcmSource(io.BytesIO(data), rate_hz)))
    begin = np.flatnonzero(np.abs(sound) > 0.01)[0] // 960 * 960
    expected = 0.5 * np.sin(2 * np.pi * 440 * np.arange(12_000) / 48_000)
    assert np.abs(sound[begin : begin + 12_000] - expected)[500:-500].max() < 0.01
    assert not np.abs(sound[-960 * (TAIL_FRAMES - 2) :]).max() > 0.01


def test_who_writes_faster_than_it_is_heard_waits() -> None:
    read, write = os.pipe()
    os.set_blocking(write, False)
    with io.FileIO(write, "w") as pipe:

        async def write_much() -> None:
            frames = PcmSource(io.FileIO(read), 48_000).frames(asyncio.Event())
            assert len((await anext(frames))[0]) == 960
            assert None in [pipe.write(bytes(64_000)) for _ in range(20)]  # it would have to wait

        asyncio.run(write_much())


def test_what_cannot_be_said_is_one_line() -> None:
    for rate in (7950, 8001, 96_050):
        with pytest.raises(OptionError, match=f"rate is {rate} Hz; multiples of 50 from 8000"):
            PcmSource(io.BytesIO(), rate)
    with pytest.raises(SourceError, match="pcm nowhere cannot be read: No such file"):
        agent(AgentOptions(pcm="nowhere"))
