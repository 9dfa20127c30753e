"""Build the three container images and start what they start.

    build    the Dockerfiles as they are, by buildah, which needs no engine
    relay    refuses to start without keys; with them it is well by its own health check, and
             SIGTERM ends it with 0
    viewer   `pica doctor`
    train    a capture, a few steps of training and an avatar file, as the image's user

Needs root on Linux with buildah. Not checked: limits that an engine sets (read-only root, dropped
capabilities, memory), the compose file and the manifests, whose commands and settings
`tests/server/test_deployment_files.py` checks.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ("relay", "viewer", "train")
HOST_USER, IMAGE_USER = 1000, 10001
"""The owner of a key file who runs a container under their own id, and the images' own user."""
TIMEOUT_S = 900.0
TRAIN_LINES = (
    "capture person --out capture --frames 12 --cameras 5 --size 96x72 --texture-size 64",
    "train --capture capture --out run --preset tiny --eval-frames 1",
    "export --run run --capture capture --out avatar.pica --name Ada --no-levels",
)


def buildah(*words: str | Path) -> str:
    """Return what buildah prints; raise SystemExit when it fails."""
    done = subprocess.run(["buildah", *words], stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"buildah {' '.join(map(str, words[:4]))} ended with {done.returncode}")
    return done.stdout.strip()


def build(name: str, volumes: Sequence[str]) -> None:
    """Build an image; `volumes` are buildah's, for a machine's own package settings."""
    begin_s = time.monotonic()
    mounts = [word for each in volumes for word in ("--volume", each)]
    options = ("--quiet", "--format", "docker", "--network", "host", *mounts)
    file = ROOT / "docker" / f"{name}.Dockerfile"
    buildah("bud", *options, "--file", file, "--tag", f"pica-{name}", ROOT)
    print(f"build: pica-{name}, {time.monotonic() - begin_s:.0f} s")


class Container:
    """One container of an image: what it starts, with its variables, as its user or another."""

    def __init__(self, image: str, options: Sequence[str]) -> None:
        inspected = json.loads(buildah("inspect", "--type", "image", image))
        self._config: dict[str, Any] = inspected["Docker"]["config"]
        self._name = buildah("from", "--pull-never", image)
        self._options = options

    def start(
        self, words: Sequence[str], environment: Mapping[str, str], *, is_check: bool = False
    ) -> subprocess.Popen[str]:
        """Start the entry point with `words` or the image's own command, or the health check."""
        command = [*self._config["Entrypoint"], *(words or self._config["Cmd"])]
        if is_check:
            _, *command = self._config["Healthcheck"]["Test"]
        values = [word for pair in environment.items() for word in ("--env", "=".join(pair))]
        run = ["buildah", "run", "--no-hosts", *self._options, *values, self._name, "--", *command]
        return subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def run(self, line: str = "", *, status: int = 0) -> str:
        """Run to the end and return what was printed; SystemExit with another exit status."""
        process = self.start(shlex.split(line), {})
        printed, _ = process.communicate(timeout=TIMEOUT_S)
        if process.returncode != status:
            sys.exit(f"pica {line} ended with {process.returncode}:\n{printed}")
        return printed

    def is_healthy(self, environment: Mapping[str, str]) -> bool:
        """Return the verdict of the image's own health check."""
        return not self.start((), environment, is_check=True).wait(TIMEOUT_S)

    def remove(self) -> None:
        """Remove the container."""
        buildah("rm", self._name)


@contextmanager
def container(image: str, *options: str) -> Iterator[Container]:
    """Yield a container that is removed at the end; `options` are those of `buildah run`."""
    made = Container(image, options)
    try:
        yield made
    finally:
        made.remove()


def signal_pica(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Send a signal to the `pica` process below a container's, as an engine does."""
    pids = [process.pid]
    for pid in pids:
        for task in Path(f"/proc/{pid}/task").iterdir():
            pids += map(int, (task / "children").read_text().split())
        if Path(f"/proc/{pid}/comm").read_text().strip() == "pica":
            os.kill(pid, number)


def check_relay(folder: Path) -> None:
    """Start the image's own command, without keys and with them."""
    with container("pica-relay") as made:
        line, *_ = made.run(status=2).splitlines()  # buildah adds a line of its own
        print(f"relay: without keys: {line}")
    shutil.chown(folder, HOST_USER, HOST_USER)
    options = ("--volume", f"{folder}:/run/secrets", "--user", f"{HOST_USER}:{HOST_USER}")
    with container("pica-relay", *options) as made:
        made.run("token --keys /run/secrets/keys --new-key")
        environment = {"PICA_RELAY_KEYS": "/run/secrets/keys"}
        process = made.start((), environment)
        deadline_s = time.monotonic() + 60.0
        while not made.is_healthy(environment):
            if process.poll() is not None or time.monotonic() > deadline_s:
                signal_pica(process, signal.SIGKILL)
                sys.exit(f"the relay is not well: {process.communicate()[0]}")
            time.sleep(0.2)
        signal_pica(process, signal.SIGTERM)
        printed, _ = process.communicate(timeout=60.0)
        if process.returncode or made.is_healthy(environment):
            sys.exit(f"the relay ended with {process.returncode}:\n{printed}")
        print("relay: well over HTTP, and ended by SIGTERM")


def check_viewer(_: Path) -> None:
    """Run the doctor: everything that a viewer needs is there."""
    with container("pica-viewer") as made:
        print(f"viewer:\n{made.run('doctor')}")


def check_train(folder: Path) -> None:
    """Go from nothing to an avatar file, as the image's user."""
    shutil.chown(folder, IMAGE_USER, IMAGE_USER)
    with container("pica-train", "--volume", f"{folder}:/runs") as made:
        for line in TRAIN_LINES:
            made.run(line)
    size = (folder / "avatar.pica").stat().st_size
    print(f"train: capture, training and export; {size / 1e6:.1f} MB")


def main() -> None:
    """Build the images and check each with a folder of its own."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--volume", action="append", default=[], help="for the builds: FROM:TO:ro")
    parser.add_argument("--only", choices=IMAGES, nargs="+", default=list(IMAGES))
    options = parser.parse_args()
    os.environ.setdefault("STORAGE_DRIVER", "vfs")
    os.environ.setdefault("BUILDAH_ISOLATION", "chroot")
    checks = {"relay": check_relay, "viewer": check_viewer, "train": check_train}
    for name in options.only:
        build(name, options.volume)
        with tempfile.TemporaryDirectory(prefix=f"pica-{name}-") as folder:
            Path(folder).chmod(0o755)
            checks[name](Path(folder))


if __name__ == "__main__":
    main()
