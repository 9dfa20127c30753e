"""A PulseAudio server of two devices that exist nowhere, for tests: what is played can be heard."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

START_S = 10.0


def is_missing() -> bool:
    """Whether PulseAudio is not installed."""
    return shutil.which("pulseaudio") is None or shutil.which("pactl") is None


def unload(sink: str) -> None:
    """Unplug a loudspeaker."""
    for line in pactl("list", "short", "modules").splitlines():
        if f"sink_name={sink} " in line + " ":
            pactl("unload-module", line.split()[0])


def pactl(*words: str) -> str:
    """Tell the server something; its answer."""
    done = subprocess.run(["pactl", *words], capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()


@contextmanager
def sound_server(folder: Path) -> Iterator[None]:
    """Run a server with two loudspeakers: "Speaker", whose sound the microphone hears, and
    "Mono44k", which is what its name says."""
    folder.chmod(0o700)
    names = {"HOME": str(folder), "XDG_RUNTIME_DIR": str(folder), "PULSE_RUNTIME_PATH": str(folder)}
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(names)
    modules = (
        f"module-native-protocol-unix socket={folder}/native",
        "module-null-sink sink_name=spk rate=48000 sink_properties=device.description=Speaker",
        "module-null-sink sink_name=old rate=44100 channels=1"
        " sink_properties=device.description=Mono44k",
    )
    os.environ["PULSE_SERVER"] = f"unix:{folder}/native"
    server = subprocess.Popen(
        ["pulseaudio", "-n", "--daemonize=no", "--exit-idle-time=-1", "--use-pid-file=no"]
        + [f"--load={module}" for module in modules],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until_s = time.monotonic() + START_S
        while True:
            try:
                pactl("set-default-sink", "spk")
                pactl("set-default-source", "spk.monitor")
                break
            except subprocess.SubprocessError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.1)
        yield
    finally:
        server.terminate()
        server.wait(timeout=10)
        del os.environ["PULSE_SERVER"]
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
