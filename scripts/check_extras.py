"""Install the parts that run alone in fresh environments, and start them there.

    base    `pica relay` starts, and neither numpy nor torch is installed
    cluster with it, and without numpy, the relay's way to NATS imports
    view    every module of `pica_client` imports, and torch, SciPy and cryptography are not there;
            only those of `pica_client.e2ee` need the extra seal, and the benches the extra bench
    seal    with it, a sender's install imports them too

The first three grow in one environment, as none may have what a later one brings. Both are
temporary; wheels come from pip's cache when it has them.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TIMEOUT_S = 60


class Environment:
    """A virtual environment in a new folder.

    Args:
        wheel: The project, built once for all.
    """

    def __init__(self, folder: Path, wheel: Path) -> None:
        self._wheel, self.folder = wheel, folder
        venv.create(folder, with_pip=True)
        self.python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"

    def install(self, extras: str) -> None:
        """Install the project with these extras."""
        target = f"{self._wheel}[{extras}]" if extras else str(self._wheel)
        pip(self.python, "install", "--constraint", str(ROOT / "constraints.txt"), target)


def pip(python: Path, command: str, *arguments: str) -> None:
    """Run a command of pip."""
    words = [str(python), "-m", "pip", "--disable-pip-version-check", command, "--quiet"]
    subprocess.run([*words, *arguments], check=True)


def assert_absent(python: Path, *modules: str) -> None:
    """Fail if a module can be imported there."""
    code = "import importlib.util as u, sys; sys.exit(any(u.find_spec(m) for m in sys.argv[1:]))"
    result = subprocess.run([python, "-I", "-c", code, *modules], cwd="/")
    if result.returncode:
        sys.exit(f"one of {', '.join(modules)} is installed in {python.parent.parent}")


def check_relay(base: Environment) -> None:
    """The base install runs a relay without numpy."""
    base.install("")
    python, folder = base.python, base.folder
    assert_absent(python, "numpy", "torch", "onnxruntime", "moderngl")
    ready = folder / "ready"
    words = ["-I", "-m", "pica_command", "relay", "--port", "0", "--ready-file", str(ready)]
    relay = subprocess.Popen([str(python), *words], cwd=folder, stderr=subprocess.DEVNULL)
    try:
        for _ in range(TIMEOUT_S * 10):
            if ready.exists() or relay.poll() is not None:
                break
            try:
                relay.wait(0.1)
            except subprocess.TimeoutExpired:
                continue
        if not ready.exists():
            sys.exit(f"the relay did not start; exit status {relay.poll()}")
        relay.send_signal(signal.SIGINT)
        if relay.wait(TIMEOUT_S) != 0:
            sys.exit(f"the relay ended with status {relay.returncode}")
    finally:
        if relay.poll() is None:
            relay.kill()
            relay.wait()
    print("base: the relay runs without numpy")


IMPORT_MODULES = """
import importlib, pkgutil, sys
inside, left_out = sys.argv[1], sys.argv[2:]
name = inside.partition(".")[0]
package = importlib.import_module(name)
names = [m.name for m in pkgutil.walk_packages(package.__path__, name + ".")]
names = [n for n in names if n.startswith(inside) and not n.startswith(tuple(left_out))]
[importlib.import_module(n) for n in names]
print(len(names), "modules of", inside, "import")
"""


def import_modules(python: Path, inside: str, *left_out: str) -> str:
    """Import every module of a package there, save those whose names begin otherwise."""
    command = [str(python), "-I", "-c", IMPORT_MODULES, inside, *left_out]
    output = subprocess.run(command, cwd="/", check=True, capture_output=True, text=True)
    return output.stdout.strip()


def check_cluster(base: Environment) -> None:
    """A relay's install has its way to NATS with the extra cluster."""
    base.install("cluster")
    assert_absent(base.python, "numpy", "torch")
    print(f"cluster: {import_modules(base.python, 'pica_server.placement.bucket')}")


def check_client(base: Environment) -> None:
    """The viewer's install imports the client but its benches: no torch, SciPy, cryptography."""
    base.install("view")
    assert_absent(base.python, "torch", "scipy", "cryptography")
    others = ("pica_client.e2ee.", "pica_client.bench.", "pica_client.cli.bench")
    print(f"view: {import_modules(base.python, 'pica_client', *others)}")


def check_seal(sender: Environment) -> None:
    """A sender's install can encrypt with the extra seal, without what only a viewer needs."""
    sender.install("send,seal")
    assert_absent(sender.python, "torch", "onnxruntime", "moderngl")
    print(f"seal: {import_modules(sender.python, 'pica_client.e2ee')}")


def main() -> None:
    """Build the project, and check all."""
    with tempfile.TemporaryDirectory(prefix="pica-extras-") as name:
        folder = Path(name)
        pip(Path(sys.executable), "wheel", "--no-deps", "--wheel-dir", name, str(ROOT))
        (wheel,) = folder.glob("*.whl")
        base = Environment(folder / "base", wheel)
        for check in (check_relay, check_cluster, check_client):
            check(base)
        check_seal(Environment(folder / "sender", wheel))


if __name__ == "__main__":
    main()
