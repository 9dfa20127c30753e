"""Build the three container images and start what they, the compose file and the manifests start.

    base       pulled; where no registry answers, made of Debian's packages by mmdebstrap
    build      the Dockerfiles as they are, by buildah, which needs no engine
    relay      as its user: refuses to start without keys; as the user of the key file: is well by
               its own health check, writes nothing but its /tmp, and SIGTERM ends it with 0
    manifests  the relay with the ConfigMap's settings and TLS, asked as the probes ask
    viewer     `pica doctor`
    train      a capture, a few steps of training and an avatar file, as its user
    compose    NATS of this machine, both relays, five senders and the viewer with the commands and
               variables of the compose file: one cluster, five of five seen, a film

All that runs lies in network namespaces of its own, from which nothing leads out. Needs root on
Debian with buildah, mmdebstrap, iproute2 and nats-server. Not checked: limits that an engine sets
(read-only root, dropped capabilities, memory).
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
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
DOCKER = ROOT / "docker"
IMAGES = ("relay", "viewer", "train")
HOST_USER = 1000
"""Who has made a key file and runs a container as themselves, as the relay's Dockerfile says."""
TIMEOUT_S = 120.0
TRAIN_TIMEOUT_S = 900.0
ADDRESSES = {"nats": "10.77.0.2", "relay-a": "10.77.0.3", "relay-b": "10.77.0.4"}
"""Hosts of the compose file's network: a namespace each, joined by a bridge that leads nowhere."""

sys.path.insert(0, str(ROOT / "tests"))
from helpers.certificates import write_certificate  # noqa: E402


def buildah(*words: str | Path, **options: Any) -> str:
    """What buildah prints; SystemExit when it fails."""
    done = subprocess.run(
        ["buildah", *words], stdout=subprocess.PIPE, text=True, check=False, **options
    )
    if done.returncode:
        sys.exit(f"buildah {' '.join(map(str, words[:4]))} ended with {done.returncode}")
    return str(done.stdout).strip()


def base_image() -> str:
    """The image that all Dockerfiles begin with."""
    bases = {
        line.split()[1]
        for path in DOCKER.glob("*.Dockerfile")
        for line in path.read_text().splitlines()
        if line.startswith("FROM ")
    }
    (base,) = bases
    return f"docker.io/library/{base}"


def provide_base() -> None:
    """Have the base image: kept, pulled, or made of the distribution's packages under its name."""
    name = base_image()
    if buildah("images", "--quiet", "--filter", f"reference={name}"):
        print(f"base: {name} is there")
        return
    if not subprocess.run(["buildah", "pull", "--quiet", name], check=False).returncode:
        print(f"base: {name} pulled")
        return
    release = name.rpartition("-")[2]
    with tempfile.TemporaryDirectory() as folder:
        packages = "--include=python3,python3-venv,python3-pip,ca-certificates"
        root = Path(folder, "root")
        subprocess.run(
            ["mmdebstrap", "--quiet", "--variant=minbase", packages, release, root], check=True
        )
        (root / "usr/bin/python").symlink_to("python3")
        container = buildah("from", "scratch")
        buildah("copy", "--quiet", container, root, "/")
        buildah("commit", "--quiet", "--rm", container, name)
    print(f"base: no registry; made of {release}'s packages")


def build(volumes: Sequence[str]) -> None:
    """Build all images; `volumes` are buildah's, for a machine's own package settings."""
    provide_base()
    mounts: list[str | Path] = [word for each in volumes for word in ("--volume", each)]
    for name in IMAGES:
        begin = time.monotonic()
        buildah(
            *("bud", "--quiet", "--format", "docker", "--network", "host", "--pull-never"),
            *mounts,
            *("--file", DOCKER / f"{name}.Dockerfile", "--tag", f"pica-{name}", ROOT),
        )
        size = json.loads(buildah("images", "--json", f"pica-{name}"))[0]["size"]
        print(f"build: pica-{name}, {size}, {time.monotonic() - begin:.0f} s")


class Container:
    """One container of an image: what it starts, with its variables, as its user or another."""

    def __init__(self, image: str, volumes: Mapping[Path, str], host: str, user: str) -> None:
        inspected = json.loads(buildah("inspect", "--type", "image", image))
        self._config = inspected["Docker"]["config"]
        self._name = buildah("from", "--pull-never", image)
        self._options = [
            word for path, place in volumes.items() for word in ("--volume", f"{path}:{place}")
        ]
        self._options += ["--user", user] if user else []
        self._inside = inside(host)
        self._begin = time.time()

    def command(self, words: Sequence[str], environment: Mapping[str, str]) -> list[str]:
        """The command line that runs `words` in this container."""
        values = [word for pair in environment.items() for word in ("--env", "=".join(pair))]
        run = ["buildah", "run", "--no-hosts", *self._options, *values, self._name]
        return [*self._inside, *run, "--", *words]

    def start(
        self, words: Sequence[str] = (), environment: Mapping[str, str] | None = None
    ) -> subprocess.Popen[str]:
        """Start the entry point with `words`, or with the image's own command."""
        command = [*self._config["Entrypoint"], *(words or self._config["Cmd"])]
        return subprocess.Popen(
            self.command(command, environment or {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(
        self,
        words: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
        *,
        status: int = 0,
        timeout_s: float = TIMEOUT_S,
    ) -> str:
        """Run to the end and return what was printed; SystemExit with another exit status."""
        process = self.start(words, environment)
        try:
            printed, _ = process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            kill(process)
            sys.exit(f"pica {' '.join(words)} took more than {timeout_s:.0f} s")
        if process.returncode != status:
            sys.exit(f"pica {' '.join(words)} ended with {process.returncode}:\n{printed}")
        return printed

    def is_healthy(self, environment: Mapping[str, str]) -> bool:
        """Whether the image's own health check says so."""
        kind, *words = self._config["Healthcheck"]["Test"]
        assert kind == "CMD"
        command = self.command(words, environment)
        return not subprocess.run(command, capture_output=True, check=False).returncode

    def written(self) -> list[str]:
        """Files below the root that were written since the start, /tmp and mounts apart."""
        root = buildah("mount", self._name)
        pseudo = [
            word
            for place in ("tmp", "proc", "sys", "dev", "run", "etc")
            for word in ("-path", f"{root}/{place}", "-prune", "-o")
        ]
        found = subprocess.run(
            ["find", root, *pseudo, "-type", "f", "-newermt", f"@{self._begin}", "-print"],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return [line.removeprefix(root) for line in found.stdout.splitlines()]

    def remove(self) -> None:
        """Remove the container."""
        buildah("rm", self._name)


def inside(host: str) -> list[str]:
    """What runs a command on one of the network's hosts; "" is outside of them."""
    return ["nsenter", f"--net=/run/netns/{host}"] if host else []


def join_hosts() -> None:
    """Make the network: it ends with this process's own namespace."""

    def ip(words: str, host: str = "") -> None:
        subprocess.run([*inside(host), "ip", *words.split()], check=True)

    Path("/run/netns").mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/run/netns"], check=True)
    ip("link set lo up")
    ip("link add net type bridge")
    ip("address add 10.77.0.1/24 dev net")
    ip("link set net up")
    for number, (host, address) in enumerate(ADDRESSES.items()):
        ip(f"netns add {host}")
        ip(f"link add port{number} type veth peer name eth0 netns {host}")
        ip(f"link set port{number} master net up")
        ip(f"address add {address}/24 dev eth0", host)
        ip("link set eth0 up", host)
        ip("link set lo up", host)


@contextmanager
def container(
    image: str, volumes: Mapping[Path, str] | None = None, host: str = "", user: str = ""
) -> Iterator[Container]:
    """A container on one of the network's hosts, which is removed at the end."""
    made = Container(image, volumes or {}, host, user)
    try:
        yield made
    finally:
        made.remove()


def stop(process: subprocess.Popen[str]) -> str:
    """End what a container runs with SIGTERM, as an engine does; it must end with 0."""
    for pid in descendants(process.pid):
        if Path(f"/proc/{pid}/comm").read_text().strip() == "pica":
            os.kill(pid, signal.SIGTERM)
    printed, _ = process.communicate(timeout=TIMEOUT_S)
    if process.returncode:
        sys.exit(f"ended with {process.returncode}:\n{printed}")
    return printed


def report(printed: str) -> Any:
    """The JSON object that a command ended with, whatever stands on stderr beside it."""
    return json.loads([line for line in printed.splitlines() if line.startswith("{")][-1])


def kill(process: subprocess.Popen[str]) -> None:
    """End what a container runs at once."""
    for pid in descendants(process.pid) if process.poll() is None else ():
        os.kill(pid, signal.SIGKILL)
    process.wait()


def descendants(pid: int) -> list[int]:
    """All processes below one."""
    children = [
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    return children + [each for child in children for each in descendants(child)]


@contextmanager
def relay(made: Container, words: Sequence[str], environment: Mapping[str, str]) -> Iterator[None]:
    """A relay that is well, by its own health check, and ends in good order."""
    process = made.start(words, environment)
    try:
        deadline = time.monotonic() + TIMEOUT_S
        while not made.is_healthy(environment):
            if process.poll() is not None or time.monotonic() > deadline:
                kill(process)
                sys.exit(f"the relay is not well: {process.communicate()[0]}")
            time.sleep(0.2)
        yield
        for line in stop(process).splitlines():
            json.loads(line)  # all of the log is JSON
    finally:
        kill(process)
    if made.is_healthy(environment):
        sys.exit("the health check says that a relay is well that has ended")


def give(path: Path) -> Path:
    """Give a file or folder to the images' user."""
    shutil.chown(path, 10001, 10001)
    return path


def check_relay(folder: Path) -> None:
    """The image's own command, without keys and with them."""
    with container("pica-relay") as made:
        line, *_ = made.run(status=2).splitlines()  # buildah adds a line of its own
        print(f"relay: without keys: {line}")
    shutil.chown(folder, HOST_USER, HOST_USER)
    user = f"{HOST_USER}:{HOST_USER}"
    with container("pica-relay", {folder: "/run/secrets"}, user=user) as made:
        made.run(["token", "--keys", "/run/secrets/keys", "--new-key"])
        environment = {"PICA_RELAY_KEYS": "/run/secrets/keys"}
        with relay(made, (), environment):
            (uid,) = {
                Path(f"/proc/{pid}").stat().st_uid
                for pid in descendants(os.getpid())
                if Path(f"/proc/{pid}/comm").read_text().strip() == "pica"
            }
            print(f"relay: well over HTTP, as user {uid}")
        if written := made.written():
            sys.exit(f"the relay wrote outside of /tmp: {written}")


def check_manifests(folder: Path) -> None:
    """The Deployment's command with the ConfigMap's settings, asked as the probes ask."""
    documents = list(yaml.safe_load_all((DOCKER / "kubernetes/relay.yaml").read_text()))
    by_kind = {one["kind"]: one for one in documents}
    (pod,) = by_kind["Deployment"]["spec"]["template"]["spec"]["containers"]
    settings = by_kind["ConfigMap"]["data"]["relay.toml"]
    (folder / "config").mkdir()
    (folder / "config/relay.toml").write_text(settings)
    (folder / "tls").mkdir()
    certificate = write_certificate(folder)
    shutil.move(certificate, folder / "tls/tls.crt")
    shutil.move(certificate.with_suffix(".key"), folder / "tls/tls.key")
    (folder / "secrets").mkdir()
    for path in (folder / "secrets", folder / "tls/tls.key"):
        give(path)
    mounts = {each["name"]: each["mountPath"] for each in pod["volumeMounts"]}
    volumes = {
        folder / "config": mounts["config"],
        folder / "secrets": mounts["keys"],
        folder / "tls": mounts["tls"],
        hosts(folder): "/etc/hosts",
    }
    # The health check asks over TLS when the variable names a certificate, as the probes do.
    environment = {"PICA_RELAY_TLS_CERT": f"{mounts['tls']}/tls.crt"}
    with nats(folder), container("pica-relay", volumes) as made:
        made.run(["token", "--keys", f"{mounts['keys']}/keys", "--new-key"])
        with relay(made, pod["args"], environment):
            print("manifests: the relay is well over TLS with the ConfigMap's settings")


def hosts(folder: Path) -> Path:
    """A hosts file with the names of the compose file's services."""
    path = folder / "hosts"
    lines = {"localhost": "127.0.0.1", **ADDRESSES}
    path.write_text("".join(f"{address} {name}\n" for name, address in lines.items()))
    return path


@contextmanager
def nats(folder: Path) -> Iterator[None]:
    """This machine's nats-server with the compose file's words."""
    service = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]["nats"]
    words = [str(word) for word in service["command"]]
    words[words.index("--store_dir") + 1] = str(folder / "nats")
    command = [*inside("nats"), "nats-server", *words]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        *_, url = service["healthcheck"]["test"]
        deadline = time.monotonic() + TIMEOUT_S
        while True:
            try:
                urllib.request.urlopen(url.replace("127.0.0.1", ADDRESSES["nats"]), timeout=3)
                break
            except OSError:
                if time.monotonic() > deadline:
                    sys.exit("nats-server does not come up")
                time.sleep(0.1)
        yield
    finally:
        process.terminate()
        process.wait()


def check_viewer(_: Path) -> None:
    """The image's own command: everything that a viewer needs is there."""
    with container("pica-viewer") as made:
        findings = report(made.run(["doctor", "--json"]))["findings"]
    print("viewer: " + ", ".join(f"{each['subject']} {each['level']}" for each in findings))


def check_train(folder: Path) -> None:
    """From nothing to an avatar file, as the image's user."""
    give(folder)
    with container("pica-train", {folder: "/runs"}) as made:
        for line in TRAIN_LINES:
            made.run(shlex.split(line), timeout_s=TRAIN_TIMEOUT_S)
    size = (folder / "avatar.pica").stat().st_size
    print(f"train: capture, training and export; {size / 1e6:.1f} MB")


TRAIN_LINES = (
    "capture synth --out capture --frames 12 --cameras 5 --size 96x72 --texture-size 64",
    "train --capture capture --out run --preset tiny --eval-frames 1",
    "export --run run --capture capture --out avatar.pica --name Ada --no-stream --no-levels",
)


def check_compose(folder: Path) -> None:
    """The compose file's cluster and its call of five, seen by its viewer."""
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    names = {hosts(folder): "/etc/hosts"}
    out = folder / "out"
    out.mkdir()
    give(out)
    with ExitStack() as stack:
        stack.enter_context(nats(folder))
        for name in ("relay-a", "relay-b"):
            made = stack.enter_context(container("pica-relay", names, name))
            service = services[name]
            stack.enter_context(relay(made, service["command"], service["environment"]))
        senders = []
        for service in services.values():
            if "profiles" in service and service["command"][0] == "send":
                made = stack.enter_context(container("pica-viewer", names))
                senders.append(made.start(service["command"]))
                stack.callback(kill, senders[-1])  # where a check has failed
        made = stack.enter_context(container("pica-viewer", {**names, out: "/out"}))
        seen = report(made.run([*services["viewer"]["command"], "--json"]))
        for sender in senders:
            stop(sender)
    size = (out / "call.mp4").stat().st_size
    if seen["rendered_peers"] != len(senders) or seen["errors"]:
        sys.exit(f"the viewer saw {seen}")
    print(f"compose: {len(senders)} of 5 seen over two relays; {size / 1e6:.1f} MB of film")


CHECKS: dict[str, Callable[[Path], None]] = {
    "relay": check_relay,
    "manifests": check_manifests,
    "viewer": check_viewer,
    "train": check_train,
    "compose": check_compose,
}


def check(names: Sequence[str]) -> None:
    """Start all that is named, one after the other, each with a folder of its own."""
    for name in names:
        with tempfile.TemporaryDirectory(prefix=f"pica-{name}-") as folder:
            Path(folder).chmod(0o755)
            CHECKS[name](Path(folder))


def main() -> None:
    """Build, then check in a network namespace that has only loopback."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--volume", action="append", default=[], help="for the builds: FROM:TO:ro")
    parser.add_argument("--no-build", action="store_true", help="check images that are there")
    parser.add_argument("--only", choices=CHECKS, nargs="+", default=list(CHECKS))
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ.setdefault("STORAGE_DRIVER", "vfs")
    os.environ.setdefault("BUILDAH_ISOLATION", "chroot")
    if options.inside:
        join_hosts()
        check(options.only)
        return
    if not options.no_build:
        build(options.volume)
    again = [sys.executable, __file__, "--inside", "--only", *options.only]
    os.execvp("unshare", ["unshare", "--net", "--mount", *again])


if __name__ == "__main__":
    main()
