"""Sounds of files that are sent as a voice: of any rate and number of channels, or refused."""

import asyncio
import io
import os
import struct
import wave
from pathlib import Path

import av
import numpy as np
import pytest

from pica_client.cli.send import AgentOptions, agent
from pica_client.errors import OptionError, SourceError
from pica_client.voice import source
from pica_client.voice.source import TAIL_FRAMES, PcmSource, open_voice, read_wav
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit


def wav(path: Path, rate_hz: int = 44_100, channels: int = 2) -> Path:
    """Half a second of a tone of 440 Hz, in all channels."""
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(rate_hz // 2) / rate_hz)
    data = np.repeat(np.round(tone * 32767).astype("<i2"), channels).tobytes()
    with wave.open(str(path), "wb") as file:
        file.setparams((channels, 2, rate_hz, 0, "NONE", ""))
        file.writeframes(data)
    return path


@pytest.mark.parametrize(("rate_hz", "channels"), [(44_100, 2), (48_000, 1), (16_000, 1)])
def test_any_rate_and_number_of_channels_become_48_khz_of_one(
    tmp_path: Path, rate_hz: int, channels: int
) -> None:
    sound = read_wav(wav(tmp_path / "a.wav", rate_hz, channels))
    assert sound.dtype == np.float32
    assert len(sound) == pytest.approx(24_000, abs=2)
    expected = 0.5 * np.sin(2 * np.pi * 440 * np.arange(len(sound)) / 48_000)
    assert np.abs(sound - expected)[1000:-1000].max() < 0.01


def test_what_is_no_wav_file_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.wav"
    whole = wav(path).read_bytes()
    unknown = whole[:20] + b"\x99\x99" + whole[22:]  # the tag of no codec
    cut = b"RIFF\xff\xff\xff\xffWAVEfmt "
    for data in (b"", b"RIFF", b"\0" * 100, b"ID3 an MP3" * 20, cut, unknown):
        path.write_bytes(data)
        with pytest.raises(SourceError, match=r"a\.wav: no WAV file of PCM sound"):
            open_voice(str(path))
    with pytest.raises(SourceError, match="no WAV file"):
        open_voice(str(tmp_path / "nowhere.wav"))
    with pytest.raises(SourceError, match="4000 Hz"):
        read_wav(wav(path, rate_hz=4_000))
    monkeypatch.setattr(source, "MAX_SECONDS", 0.4)
    with pytest.raises(SourceError, match=r"at most 0\.4 s of sound"):
        read_wav(wav(path))


@pytest.mark.parametrize("codec", ["pcm_u8", "pcm_s16le", "pcm_s24le", "pcm_s32le", "pcm_f32le"])
def test_samples_of_any_kind_are_read(tmp_path: Path, codec: str) -> None:
    tone = 0.5 * np.sin(np.arange(960) / 9).astype(np.float32)
    with av.open(str(tmp_path / "a.wav"), "w") as container:
        stream = container.add_stream(codec, rate=48_000, layout="mono")
        frame = av.AudioFrame.from_ndarray(tone[None], format="flt", layout="mono")
        frame.sample_rate = 48_000
        container.mux([*stream.encode(frame), *stream.encode(None)])
    step = 1 / 64 if codec == "pcm_u8" else 1e-4
    np.testing.assert_allclose(read_wav(tmp_path / "a.wav"), tone, atol=step)


@pytest.mark.parametrize("size", [0, 0xFFFF_FFFF])
def test_a_length_that_a_pipe_left_open_is_that_of_the_file(tmp_path: Path, size: int) -> None:
    path = wav(tmp_path / "a.wav", 48_000, 1)
    data = path.read_bytes()
    path.write_bytes(data[:40] + struct.pack("<I", size) + data[44:])
    assert len(read_wav(path)) == 24_000


def test_a_file_that_is_cut_off_is_played_as_far_as_it_goes_or_refused(tmp_path: Path) -> None:
    for num_bytes in (44, 45, 46, 47, 1001):
        path = wav(tmp_path / "a.wav")
        path.write_bytes(path.read_bytes()[:num_bytes])
        try:
            sound = read_wav(path)
        except SourceError:
            continue
        assert np.isfinite(sound).all()


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
