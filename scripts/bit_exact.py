"""Print the SHA-256 of coded faces, to compare machines, Python versions and numbers of threads.

    python scripts/bit_exact.py                                   the golden faces and tables
    python scripts/bit_exact.py --avatar ada.pica --latents talk.npy      [T, 8, 8, 4], 30 a second

One line for every way of coding, a hash over its payloads, flags and decoded numbers. Latents come
from a file, because the expression encoder that makes them is a float network: its last bits are
the business of the machine's matrix product. From there on everything is integers.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pica_core.avatar.file import load_avatar
from pica_core.codec.latent_sample import ReceivedFrame
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig
from pica_core.codec.profile import StreamProfile

GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "stream_v1.json"
CONFIGS = {
    "quality 0": StreamConfig(quality=0),
    "quality 3": StreamConfig(quality=3),
    "quality 7, two layers": StreamConfig(quality=7, num_layers=2),
    "2 kbit/s": StreamConfig(target_bps=2000),
}


def coded_hash(
    profile: StreamProfile, latents: npt.NDArray[np.float64], config: StreamConfig
) -> str:
    """Encode faces with a nodding head, decode them, and hash all that comes out."""
    encoder, decoder = LatentEncoder(profile, config), LatentDecoder(profile)
    digest = hashlib.sha256()
    sequence = 0
    for index, latent in enumerate(latents):
        # Triangles, not sines: their last bits would be the business of a library.
        nod = abs(index % 64 - 32) / 512
        rotation, translation_m = (nod, -nod / 2, nod / 4), (nod / 16, 0.0, -nod / 8)
        captured_us = index * 33_333
        frame = encoder.encode(latent, rotation, translation_m, captured_us)
        if frame is None:
            digest.update(b"none;")
            continue
        digest.update(f"{frame.layer} {frame.is_keyframe} {frame.payload.hex()};".encode())
        (shown,) = decoder.receive(
            ReceivedFrame(sequence, captured_us, frame.layer, frame.is_keyframe, frame.payload)
        )
        sequence += 1
        for array in (shown.sample.latent, shown.sample.rotation, shown.sample.translation_m):
            digest.update(array.astype("<f4").tobytes())
    return digest.hexdigest()


def golden() -> tuple[StreamProfile, npt.NDArray[np.float64]]:
    """Tables and faces of the golden vectors."""
    vectors = json.loads(GOLDEN.read_text())
    arrays = {
        name: np.array(array["values"], array["type"]).reshape(array["shape"])
        for name, array in vectors["profile"].items()
    }
    latents = np.array(vectors["performance"]["latents"], np.float64) / 4096
    return StreamProfile(**arrays), latents.reshape(-1, 8, 8, 4)


def main() -> None:
    """Parse the options and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--avatar", type=Path)
    parser.add_argument("--latents", type=Path)
    options = parser.parse_args()
    if (options.avatar is None) != (options.latents is None):
        parser.error("--avatar and --latents go together")
    if options.avatar is None:
        profile, latents = golden()
    else:
        loaded = load_avatar(options.avatar).stream_profile()
        if loaded is None:
            parser.error(f"{options.avatar} has no tables of a stream")
        profile, latents = loaded, np.load(options.latents, allow_pickle=False)
    print(f"python {platform.python_version()}, numpy {np.__version__}, profile {profile.hash[:8]}")
    for name, config in CONFIGS.items():
        print(f"{coded_hash(profile, latents, config)}  {name}")


if __name__ == "__main__":
    main()
