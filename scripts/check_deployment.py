"""Start what the relay's image would start, without an engine for containers.

    wheel      built from the files that the Dockerfile copies, and from nothing else
    install    into a new virtual environment, with the image's extra
    settings   `pica relay --print-config` with the settings of the image, of the compose file's
               relays and of the Kubernetes manifests
    commands   of the compose file's clients and the other images: `--help` with the dispatcher
    relay      with the image's variables and a key file, in an empty environment: the image's
               health check says it is well, over plain HTTP and over TLS; SIGTERM ends it with 0
    compose    with a `nats-server` on this machine: both relays of the compose file come up as one
               cluster, by their own /metrics

It needs the packages of the development environment (yaml, cryptography) and prints what it did.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
import venv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
DOCKER = ROOT / "docker"
TIMEOUT_S = 60.0

sys.path.insert(0, str(ROOT / "tests"))
from helpers.certificates import write_certificate  # noqa: E402


def instructions(name: str) -> list[tuple[str, str]]:
    """The instructions of a Dockerfile, with their arguments on one line."""
    text = re.sub(r"\\\n\s*", " ", (DOCKER / name).read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split()[0], line.partition(" ")[2].strip()) for line in lines]


def copied_sources(folder: Path) -> Path:
    """A copy of what the image's build stage sees."""
    for name, arguments in instructions("relay.Dockerfile"):
        *sources, _ = arguments.split()
        if name != "COPY" or "--from=" in arguments or sources == ["docker/healthcheck.py"]:
            continue
        for source in sources:
            if (ROOT / source).is_dir():
                shutil.copytree(
                    ROOT / source, folder / source, ignore=shutil.ignore_patterns("__pycache__")
                )
            else:
                shutil.copy(ROOT / source, folder / source)
    return folder


def install(folder: Path, sources: Path) -> Path:
    """The image's virtual environment; returns its `pica`."""
    (target,) = re.findall(r"'\.(\[[a-z,]+\])'", (DOCKER / "relay.Dockerfile").read_text())
    venv.create(folder, with_pip=True)
    pip = [folder / "bin" / "python", "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheels = folder / "wheels"
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", wheels, sources], check=True)
    (wheel,) = wheels.glob("*.whl")
    constraint = ["--constraint", ROOT / "constraints.txt"]
    subprocess.run([*pip, "install", *constraint, f"{wheel}{target}"], check=True)
    print(f"wheel: {wheel.stat().st_size / 1e6:.1f} MB")
    return folder / "bin" / "pica"


def image_environment() -> dict[str, str]:
    """The relay's settings in its image."""
    pairs = [
        pair.split("=", 1)
        for name, arguments in instructions("relay.Dockerfile")
        if name == "ENV"
        for pair in shlex.split(arguments)
    ]
    return {name: value for name, value in pairs if name.startswith("PICA_RELAY_")}


def run(pica: Path, words: Sequence[str], environment: Mapping[str, str]) -> str:
    """Run `pica` to its end in an environment of its own."""
    done = subprocess.run(
        [pica, *words], env=dict(environment), capture_output=True, text=True, cwd="/", check=False
    )
    if done.returncode:
        sys.exit(f"pica {' '.join(words)}: {done.returncode}\n{done.stderr}")
    return done.stdout


def check_settings(pica: Path, folder: Path) -> None:
    """Every relay of every file has settings that hold together."""
    keys = {"PICA_RELAY_KEYS": "/run/secrets/keys"}
    run(pica, ["relay", "--print-config"], {**image_environment(), **keys})
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    for name, service in compose.items():
        if name.startswith("relay"):
            environment = {**image_environment(), **service["environment"]}
            run(pica, [*service["command"], "--print-config"], environment)
    documents = list(yaml.safe_load_all((DOCKER / "kubernetes" / "relay.yaml").read_text()))
    (settings,) = [one["data"]["relay.toml"] for one in documents if one["kind"] == "ConfigMap"]
    file = folder / "relay.toml"
    file.write_text(settings)
    run(pica, ["relay", "--config", str(file), "--print-config"], image_environment())
    print("settings: of the image, of the compose file and of the manifests hold together")
    known = run(pica, ["--help"], {})
    for name, service in compose.items():
        if "profiles" in service and f"pica {service['command'][0]}\n" not in known:
            sys.exit(f"compose file: {name} starts `pica {service['command'][0]}`, which is not")
    print("commands: those of the compose file's clients are there")


def free_port() -> str:
    """A port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return str(probe.getsockname()[1])


def health(pica: Path, environment: Mapping[str, str]) -> int:
    """The exit status of the image's health check."""
    command = [pica.parent / "python", DOCKER / "healthcheck.py"]
    return subprocess.run(
        command, env=dict(environment), stderr=subprocess.DEVNULL, check=False
    ).returncode


@contextmanager
def relay(
    pica: Path, words: Sequence[str], environment: Mapping[str, str]
) -> Iterator[subprocess.Popen[str]]:
    """A relay that is well, by its own health check; it must end in good order."""
    environment = dict(environment)
    process = subprocess.Popen(
        [pica, *words], env=environment, cwd="/", stderr=subprocess.PIPE, text=True
    )
    try:
        deadline = time.monotonic() + TIMEOUT_S
        while health(pica, environment):
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                sys.exit(f"the relay is not well: {process.communicate()[1]}")
            time.sleep(0.1)
        yield process
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=TIMEOUT_S)
        if process.returncode:
            sys.exit(f"the relay ended with {process.returncode}: {log}")
        if not all(line.startswith("{") for line in log.splitlines()):
            sys.exit(f"not all of the log is JSON: {log}")
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    if not health(pica, environment):
        sys.exit("the health check says that a relay is well that has ended")


def check_relay(pica: Path, folder: Path) -> None:
    """The image's command with a key file, plain and with TLS."""
    keys = folder / "keys"
    run(pica, ["token", "--keys", str(keys), "--new-key"], {})
    environment = {
        **image_environment(),
        "PICA_RELAY_PORT": free_port(),
        "PICA_RELAY_KEYS": str(keys),
    }
    with relay(pica, ["relay"], environment):
        print("relay: well over HTTP, with a key file")
    cert = write_certificate(folder)
    environment["PICA_RELAY_TLS_CERT"] = str(cert)
    environment["PICA_RELAY_TLS_KEY"] = str(cert.with_suffix(".key"))
    with relay(pica, ["relay"], environment):
        print("relay: well over TLS")


def numbers(port: str) -> dict[str, float]:
    """What /metrics says, without labels."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as reply:
        text = reply.read().decode()
    return {
        name: float(value)
        for name, value in re.findall(r"^(\w+) ([0-9.e+-]+)$", text, re.MULTILINE)
    }


def check_compose(pica: Path, folder: Path) -> None:
    """The compose file's relays find each other over NATS."""
    server = shutil.which("nats-server")
    if server is None:
        print("compose: left out, there is no nats-server on this machine")
        return
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    nats_port, ports = free_port(), (free_port(), free_port())
    words = [str(word) for word in services["nats"]["command"]]
    words[words.index("--store_dir") + 1] = str(folder / "nats")
    words[words.index("--http_port") + 1] = free_port()
    address = ["--addr", "127.0.0.1", "--port", nats_port]
    nats = subprocess.Popen([server, *words, *address], stderr=subprocess.DEVNULL)
    try:
        environments = [
            {
                **image_environment(),
                **services[name]["environment"],
                "PICA_RELAY_CLUSTER": f"nats://127.0.0.1:{nats_port}",
                "PICA_RELAY_PORT": port,
            }
            for name, port in zip(("relay-a", "relay-b"), ports, strict=True)
        ]
        # As the compose file has it: first NATS, then the relays.
        deadline = time.monotonic() + TIMEOUT_S
        while socket.socket().connect_ex(("127.0.0.1", int(nats_port))):
            if time.monotonic() > deadline:
                sys.exit("nats-server does not come up")
            time.sleep(0.1)
        with relay(pica, ["relay"], environments[0]), relay(pica, ["relay"], environments[1]):
            while [numbers(port)["pica_cluster_nodes"] for port in ports] != [2.0, 2.0]:
                if time.monotonic() > deadline:
                    sys.exit(f"the relays do not find each other: {numbers(ports[0])}")
                time.sleep(0.2)
            print("compose: two relays, one cluster")
    finally:
        nats.terminate()
        nats.wait()


def main() -> None:
    """Do all of it in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="pica-deployment-") as name:
        folder = Path(name)
        (folder / "src").mkdir()
        pica = install(folder / "venv", copied_sources(folder / "src"))
        check_settings(pica, folder)
        check_relay(pica, folder)
        check_compose(pica, folder)


if __name__ == "__main__":
    if os.name == "nt":
        sys.exit("the relay is stopped with SIGTERM here, which this system has not")
    main()
