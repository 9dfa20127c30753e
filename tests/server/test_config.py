from typing import Any

import pytest

from pica_server.config import ConfigurationError, LimitsConfig, RelayConfig, StoreConfig

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.2", "relay.example.org", ""])
def test_a_relay_without_tokens_refuses_to_listen_beyond_this_machine(host: str) -> None:
    with pytest.raises(ConfigurationError, match=r"no tokens: name a key file with --keys"):
        RelayConfig(host=host)
    assert RelayConfig(host=host, insecure=True).host == host


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_this_machine_is_no_danger(host: str) -> None:
    assert RelayConfig(host=host).host == host


def test_a_relay_among_others_beyond_this_machine_needs_an_address_to_redirect_to() -> None:
    cluster = "nats://127.0.0.1:4222"
    with pytest.raises(ConfigurationError, match="with --public-url wss://HOST:PORT"):
        RelayConfig(host="relay.example.org", insecure=True, cluster=cluster)
    assert RelayConfig(cluster=cluster).public_url == ""


@pytest.mark.parametrize("origin", ["", "*", "example.org", "https://example.org/page"])
def test_what_is_no_origin_is_refused(origin: str) -> None:
    with pytest.raises(ConfigurationError, match="is no origin: write https://HOST"):
        RelayConfig(origins=(origin,))


@pytest.mark.parametrize(
    ("kind", "field", "value", "option"),
    [
        (RelayConfig, "port", 65_536, "--port"),
        (RelayConfig, "room_capacity", 65, "--room-capacity"),
        (RelayConfig, "max_connections", 0, "--max-connections"),
        (RelayConfig, "stall_timeout_s", float("nan"), "--stall-timeout-s"),
        (LimitsConfig, "joins_per_s", -1.0, "--limits.joins-per-s"),
        (StoreConfig, "largest_bytes", 2**26 + 1, "--store.largest-bytes"),
    ],
)
def test_a_setting_out_of_range_is_refused_by_name_with_its_range(
    kind: Any, field: str, value: float, option: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"{option} must be in .*, got {value}"):
        kind(**{field: value})
