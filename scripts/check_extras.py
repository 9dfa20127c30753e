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


def pip(python: str, command: str, *arguments: str) -> None:
    """Run a command of pip."""
    words = [python, "-m", "pip", "--disable-pip-version-check", command, "--quiet"]
    subprocess.run([*words, *arguments], check=True)


def make_environment(folder: Path) -> str:
    """Make a virtual environment; return its Python."""
    venv.create(folder, with_pip=True)
    return str(folder / ("Scripts" if os.name == "nt" else "bin") / "python")


def install(python: str, wheel: str) -> None:
    """Install the project, with extras in brackets behind its wheel."""
    pip(python, "install", "--constraint", str(ROOT / "constraints.txt"), wheel)


def assert_absent(python: str, *modules: str) -> None:
    """Fail if a module can be imported there."""
    code = "import importlib.util as u, sys; sys.exit(any(u.find_spec(m) for m in sys.argv[1:]))"
    result = subprocess.run([python, "-I", "-c", code, *modules], cwd="/")
    if result.returncode:
        sys.exit(f"one of {', '.join(modules)} is installed for {python}")


def check_relay(python: str, folder: Path) -> None:
    """The base install runs a relay without numpy."""
    assert_absent(python, "numpy", "torch", "onnxruntime", "moderngl")
    ready = folder / "ready"
    words = ["-I", "-m", "pica_command", "relay", "--port", "0", "--ready-file", str(ready)]
    relay = subprocess.Popen([python, *words], cwd=folder, stderr=subprocess.DEVNULL)
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


def import_modules(python: str, inside: str, *left_out: str) -> str:
    """Import every module of a package there, save those whose names begin otherwise."""
    command = [python, "-I", "-c", IMPORT_MODULES, inside, *left_out]
    output = subprocess.run(command, cwd="/", check=True, capture_output=True, text=True)
    return output.stdout.strip()


def main() -> None:
    """Build the project, and check its parts."""
    with tempfile.TemporaryDirectory(prefix="pica-extras-") as name:
        folder = Path(name)
        pip(sys.executable, "wheel", "--no-deps", "--wheel-dir", name, str(ROOT))
        wheel = str(*folder.glob("*.whl"))

        python = make_environment(folder / "base")
        install(python, wheel)
        check_relay(python, folder)
        install(python, f"{wheel}[cluster]")
        assert_absent(python, "numpy", "torch")
        print(f"cluster: {import_modules(python, 'pica_server.placement.bucket')}")
        install(python, f"{wheel}[view]")
        assert_absent(python, "torch", "scipy", "cryptography")
        others = ("pica_client.e2ee.", "pica_client.bench.", "pica_client.cli.bench")
        print(f"view: {import_modules(python, 'pica_client', *others)}")

        python = make_environment(folder / "sender")
        install(python, f"{wheel}[send,seal]")
        assert_absent(python, "torch", "onnxruntime", "moderngl")
        print(f"seal: {import_modules(python, 'pica_client.e2ee')}")


if __name__ == "__main__":
    main()
