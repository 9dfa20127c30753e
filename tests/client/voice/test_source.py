"""Sounds of files that are sent as a voice: of any rate and number of channels, or refused."""

import struct
import wave
from pathlib import Path

import numpy as np
import pytest

from pica_client.errors import SourceError
from pica_client.voice.source import MAX_SECONDS, open_voice, read_wav

pytestmark = pytest.mark.unit


def wav(path: Path, rate_hz: int = 44_100, channels: int = 2, width: int = 2) -> Path:
    """Half a second of a tone of 440 Hz, in all channels."""
    tone = 0.5 * np.sin(2 * np.pi * 440 * np.arange(rate_hz // 2) / rate_hz)
    data = np.repeat(np.round(tone * 32767).astype("<i2"), channels).tobytes()
    with wave.open(str(path), "wb") as file:
        file.setparams((channels, width, rate_hz, 0, "NONE", ""))
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


def test_what_is_no_wav_file_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    for data in (b"", b"RIFF", b"\0" * 100, b"ID3 an MP3" * 20, b"RIFF\xff\xff\xff\xffWAVEfmt "):
        path.write_bytes(data)
        with pytest.raises(SourceError, match=r"a\.wav: no WAV file of PCM sound"):
            open_voice(str(path))
    with pytest.raises(SourceError, match="no WAV file"):
        open_voice(str(tmp_path / "nowhere.wav"))
    with pytest.raises(SourceError, match="8 bits of format 1; 16-bit PCM is needed"):
        read_wav(wav(path, channels=2, width=1))
    with pytest.raises(SourceError, match="4000 Hz"):
        read_wav(wav(path, rate_hz=4_000))
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 8_000, 0, "NONE", ""))
        file.writeframes(bytes(2 * 8_000 * (MAX_SECONDS + 1)))
    with pytest.raises(SourceError, match=f"to {MAX_SECONDS} are played"):
        read_wav(path)


TRUE_KIND = bytes.fromhex("000000001000800000aa00389b71")
"""What follows the format in an extensible header."""


def chunk(name: bytes, content: bytes, size: int | None = None) -> bytes:
    """A part of a WAV file, which may say another size."""
    length = struct.pack("<I", len(content) if size is None else size)
    return name + length + content + bytes(len(content) % 2)


@pytest.mark.parametrize(
    ("kind", "before", "size"),
    [
        ((1, "<i2"), (b"RIFF", b""), 0),
        ((1, "<i2"), (b"RIFF", b""), 0xFFFF_FFFF),
        ((1, "<i2"), (b"RIFF", chunk(b"LIST", b"odd")), None),
        ((1, "<i2"), (b"RF64", chunk(b"ds64", struct.pack("<3QI", 0, 960, 0, 0))), 0xFFFF_FFFF),
        ((1, "<i4"), (b"RIFF", b""), None),
        ((3, "<f4"), (b"RIFF", b""), None),
        ((1, "24"), (b"RIFF", b""), None),
    ],
)
@pytest.mark.parametrize("is_extensible", [False, True])
def test_sound_is_read_as_programs_and_pipes_leave_it(
    tmp_path: Path,
    kind: tuple[int, str],
    before: tuple[bytes, bytes],
    size: int | None,
    is_extensible: bool,
) -> None:
    tone, (tag, dtype), (riff, chunks) = 0.5 * np.sin(np.arange(480) / 9), kind, before
    whole = np.round(tone * 2**31).astype("<i4")
    stored = {"<i2": (whole >> 16).astype("<i2"), "<i4": whole, "<f4": tone.astype("<f4")}
    stored["24"] = whole.view(np.uint8).reshape(-1, 4)[:, 1:]
    data = stored[dtype].tobytes()
    width = len(data) // 480
    layout = struct.pack("<HIIHH", 1, 48_000, 48_000 * width, width, 8 * width)
    layout = struct.pack("<H", 0xFFFE if is_extensible else tag) + layout
    layout += struct.pack("<HHIH", 22, 8 * width, 4, tag) + TRUE_KIND if is_extensible else b""
    rest = b"WAVE" + chunks + chunk(b"fmt ", layout) + chunk(b"data", data, size)
    (tmp_path / "a.wav").write_bytes(riff + struct.pack("<I", len(rest)) + rest)

    np.testing.assert_allclose(read_wav(tmp_path / "a.wav"), tone, atol=1e-4)


def test_a_file_that_is_cut_off_is_played_as_far_as_it_goes_or_refused(tmp_path: Path) -> None:
    for num_bytes in (44, 45, 46, 47, 1001):
        path = wav(tmp_path / "a.wav")
        path.write_bytes(path.read_bytes()[:num_bytes])
        try:
            sound = read_wav(path)
        except SourceError:
            continue
        assert np.isfinite(sound).all()
