"""What can be checked of the container and cluster files without an engine or a cluster.

Not checked here: that the tags of other people's images exist, and that a cluster accepts the
manifests, and that images start: ``make images`` builds them.
"""

import json
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import yaml

from helpers.paths import ROOT
from pica_command.options import CommandLine
from pica_command.table import COMMANDS
from pica_server.config import ConfigurationError, RelayConfig
from pica_server.pages import StatusPages
from pica_server.room.hub import Hub

pytestmark = pytest.mark.unit

DOCKER = ROOT / "docker"
DOCKERFILES = sorted(DOCKER.glob("*.Dockerfile"))
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
MANIFESTS = {
    (one["kind"], one["metadata"]["name"]): one
    for path in sorted((DOCKER / "kubernetes").glob("*.yaml"))
    for one in yaml.safe_load_all(path.read_text())
}
RELAYS = {name: one for name, one in COMPOSE["services"].items() if name.startswith("relay")}
CLIENTS = {name: one for name, one in COMPOSE["services"].items() if "profiles" in one}
# A command of our own finds what it opens only where it runs.
MOUNTED = ("/run/secrets/", "/etc/pica/")


def read_options(
    command: str, words: Sequence[str], environment: Mapping[str, str] | None = None
) -> Any:
    """Read words and variables into the options of a command that takes one dataclass."""
    with patch.dict(os.environ, environment or {}):
        given = CommandLine(command, COMMANDS[command], None).read(words)
    assert given is not None
    (options,) = given.values()
    return options


def instructions(path: Path) -> list[tuple[str, str]]:
    """Return the instructions of a Dockerfile, with their arguments on one line."""
    text = re.sub(r"\\\n\s*", " ", path.read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split()[0], line.partition(" ")[2].strip()) for line in lines]


def relay_options(words: list[str], environment: dict[str, str]) -> RelayConfig:
    """Read a relay's settings as the command does; unknown ones and bad values raise."""
    config: RelayConfig = read_options("relay", words, environment).config
    return config


def image_environment() -> dict[str, str]:
    """Return the settings that the relay's image brings."""
    words = " ".join(
        arguments for name, arguments in instructions(DOCKER / "relay.Dockerfile") if name == "ENV"
    )
    pairs = dict(word.split("=", 1) for word in shlex.split(words))
    return {name: value for name, value in pairs.items() if name.startswith("PICA_RELAY_")}


@pytest.mark.parametrize("path", DOCKERFILES, ids=lambda path: path.name)
def test_no_image_runs_as_root(path: Path) -> None:
    users = [arguments for name, arguments in instructions(path) if name == "USER"]
    # By number: Kubernetes cannot tell whether a name is root's.
    assert users
    assert re.fullmatch(r"[1-9]\d{3,}(:[1-9]\d{3,})?", users[-1])


def test_what_others_make_is_named_by_its_content() -> None:
    names = [
        name
        for path in [*DOCKER.rglob("*.*"), *ROOT.glob(".github/workflows/*.yml")]
        for name in re.findall(r"(?m)^(?:FROM|.*image:|.*uses:) ([^\s$]+)", path.read_text())
        if not name.startswith("pica-")
    ]
    assert len(names) > 10
    assert not [
        name for name in names if not re.search("@(sha256:[0-9a-f]{64}|[0-9a-f]{40})$", name)
    ]


def test_the_relays_image_refuses_to_be_open_by_mistake() -> None:
    with pytest.raises(ConfigurationError, match="this relay has no tokens"):
        relay_options([], image_environment())
    config = relay_options([], {**image_environment(), "PICA_RELAY_KEYS": "/run/secrets/keys"})
    assert (config.host, config.port) == ("0.0.0.0", 8765)


@pytest.mark.parametrize("name", RELAYS)
def test_a_relay_of_the_compose_file_can_start_and_may_do_little(name: str) -> None:
    service = RELAYS[name]
    command, *words = service["command"]
    assert command == "relay"
    environment = {**image_environment(), **service["environment"]}
    config = relay_options(words, environment)
    assert config.cluster == "nats://nats:4222"
    assert config.public_url == f"ws://{name}:8765"
    assert config.metrics_to
    assert int(service["stop_grace_period"].removesuffix("s")) > config.drain_s
    assert service["ports"][0].endswith(":8765")


@pytest.mark.parametrize("name", CLIENTS)
def test_the_clients_of_the_compose_file_have_options_that_exist(name: str) -> None:
    command, *words = CLIENTS[name]["command"]
    options = read_options(command, words)
    assert set(options.join.url.split(",")) == {f"ws://{relay}:8765" for relay in RELAYS}


def test_the_relay_of_the_manifests_can_start_and_has_time_to_drain(tmp_path: Path) -> None:
    pod = MANIFESTS["StatefulSet", "relay"]["spec"]["template"]["spec"]
    settings = tmp_path / "relay.toml"
    settings.write_text(MANIFESTS["ConfigMap", "relay"]["data"]["relay.toml"])
    (container,) = pod["containers"]
    assert container["args"] == ["relay", "--config", "/etc/pica/relay.toml"]
    environment = {each["name"]: each.get("value", "") for each in container["env"]}
    assert environment["PICA_RELAY_PUBLIC_URL"] == "wss://$(POD_NAME).example.org"
    words = ["--config", str(settings), "--public-url", "wss://relay-0.example.org"]
    config = relay_options(words, image_environment())
    assert config.keys is not None
    assert config.metrics_to == ("10.0.0.0/8",)
    assert container["ports"][0]["containerPort"] == config.port
    assert pod["terminationGracePeriodSeconds"] > config.drain_s
    mounts = {mount["mountPath"] for mount in container["volumeMounts"]}
    assert "/tmp" in mounts  # the avatar store, on a read-only root
    for path in (config.keys, config.tls_cert, config.tls_key):
        assert path is not None
        assert str(path.parent) in mounts
    nats = re.fullmatch(r"nats://([a-z]+):(\d+)", config.cluster)
    assert nats is not None
    service = MANIFESTS["Service", nats[1]]
    assert int(nats[2]) in {port["port"] for port in service["spec"]["ports"]}


def exported_series() -> set[str]:
    """Return the names of all series that /metrics has."""
    config = RelayConfig()
    page = StatusPages(Hub(config), config).answer("/metrics", is_local=True, now=0.0)
    assert page is not None
    names = set()
    for name, kind in re.findall(r"^# TYPE (\w+) (\w+)$", page.text, re.MULTILINE):
        parts = ("_bucket", "_sum", "_count") if kind == "histogram" else ("",)
        names |= {name + part for part in parts}
    return names


def expressions() -> list[str]:
    dashboard = json.loads((DOCKER / "grafana/dashboards/relay.json").read_text())
    alerts = yaml.safe_load((DOCKER / "prometheus/alerts.yml").read_text())
    return [
        *(target["expr"] for panel in dashboard["panels"] for target in panel["targets"]),
        *(rule["expr"] for group in alerts["groups"] for rule in group["rules"]),
    ]


@pytest.mark.parametrize("expression", expressions())
def test_dashboards_and_alerts_ask_for_series_that_exist(expression: str) -> None:
    names = set(re.findall(r"\bpica_\w+", expression))
    assert names <= exported_series()
    assert names or expression.startswith("up{")
