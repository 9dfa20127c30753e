"""Let coverage find bytes that break what reads them; needs atheris (`pip install atheris`, Linux).

make fuzz                                                     every target, ten seconds each
python scripts/fuzz_coverage.py message --seconds 600         one target
python scripts/fuzz_coverage.py message out/message-crash-01  a find again
python scripts/fuzz_coverage.py --plant                       write the seeds anew

A find ends the run and lies in a file in out/ that its last lines name: mend the fault, and keep
the file in tests/fuzzing/seeds/TARGET, where every run of the tests goes through it.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests")]


def main() -> None:
    """Read the command line and do it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", nargs="?", help="all of them by default")
    parser.add_argument("find", nargs="?", type=Path, help="a file to try again")
    parser.add_argument("--seconds", type=int, default=10, help="for each target")
    parser.add_argument("--plant", action="store_true", help="write the seeds anew")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.plant:
        plant()
    elif options.find is not None:
        from fuzzing.byte_targets import TARGETS

        TARGETS[options.target](options.find.read_bytes())
    elif options.inside is not None:
        seek(options.target, options.inside, options.seconds)
    elif importlib.util.find_spec("atheris") is None:
        sys.exit("atheris is not installed: pip install atheris (wheels are for Linux)")
    else:
        from fuzzing.byte_targets import SEEDS, TARGETS

        for target in [options.target] if options.target else TARGETS:
            # It never returns, so each gets a process; what it learns goes into a copy.
            with tempfile.TemporaryDirectory() as folder:
                corpus = shutil.copytree(SEEDS / target, Path(folder, target))
                words = [target, "--inside", str(corpus), "--seconds", str(options.seconds)]
                status = subprocess.run([sys.executable, __file__, *words]).returncode
                print(
                    f"{target}: {len(list(corpus.iterdir()))} inputs that differ in what they reach"
                )
            if status:
                sys.exit(status)


def seek(target: str, corpus: Path, seconds: int) -> None:
    """Run one target under libFuzzer; ends the process."""
    import atheris

    with atheris.instrument_imports(include=["pica_protocol", "pica_client.e2ee", "pica_core"]):
        from fuzzing.byte_targets import TARGETS
    # 64 KiB: the largest message, and a toy's avatar file.
    limits = [f"-max_total_time={seconds}", "-max_len=65536", "-rss_limit_mb=2048", "-timeout=10"]
    finds = ROOT / "out"
    finds.mkdir(exist_ok=True)
    limits += ["-verbosity=0", f"-artifact_prefix={finds}/{target}-"]
    atheris.Setup([sys.argv[0], *limits, str(corpus)], TARGETS[target])
    atheris.Fuzz()


def plant() -> None:
    """Write the seeds: the golden bytes, a note and a frame of each suite, a stream, an avatar."""
    from fuzzing import byte_targets
    from helpers.stream_toy import perform
    from helpers.toy import make_toy_avatar
    from pica_client.e2ee.frames import derive_key, seal
    from pica_client.e2ee.notes import Note, encode_note
    from pica_client.e2ee.suites import SUITES
    from pica_core.avatar.file import save_avatar
    from pica_core.avatar.spec import AvatarSpec

    golden = json.loads((ROOT / "tests/golden/wire.json").read_text())
    wire = [bytes.fromhex(data) for part in golden.values() for data in part.values()]
    key, way = byte_targets.NOTE_KEY, byte_targets.WAY
    wrapped = Note(public_key=bytes(32), generation=1, suite=4, wrapped_key=bytes(32))
    notes = [Note(public_key=bytes(32), wants_answer=True), wrapped]
    suites = [(derive_key(bytes(16), 7, suite), number) for number, suite in SUITES.items()]
    stream = b"".join(
        bytes([sent.layer | 8 * sent.is_keyframe, len(sent.payload)]) + sent.payload
        for sent in perform(num_frames=40)
    )
    spec = AvatarSpec(map_size=32, hidden_channels=(2,), uv_encoding_size=4, axis_encoding_size=4)
    avatar = Path(tempfile.mkdtemp(), "toy.pica")
    save_avatar(avatar, make_toy_avatar(grid=3, spec=spec))
    planted = {
        "message": [data for data in wire if data[:1] != b"\x02"],
        "media": [data for data in wire if data[:1] == b"\x02"],
        "sealed": [seal(b"face", byte_targets.METADATA, key_, n) for key_, n in suites],
        "note": [encode_note(note, key, *way) for note in notes],
        "avatar_file": [avatar.read_bytes()],
        "bitstream": [stream, stream[: len(stream) // 2]],
    }
    for target, inputs in planted.items():
        folder = byte_targets.SEEDS / target
        folder.mkdir(parents=True, exist_ok=True)
        for data in inputs:
            (folder / hashlib.sha256(data).hexdigest()[:12]).write_bytes(data)


if __name__ == "__main__":
    main()
