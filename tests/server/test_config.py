import pytest

from pica_server.config import ConfigurationError, LimitsConfig, RelayConfig

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
    ("field", "value"),
    [
        ("port", 65_536),
        ("port", -1),
        ("room_capacity", 0),
        ("room_capacity", 65),
        ("max_connections", 0),
        ("handshake_timeout_s", 0.0),
        ("stall_timeout_s", float("nan")),
        ("ping_interval_s", -1.0),
        ("close_timeout_s", 1e9),
    ],
)
def test_a_setting_out_of_range_is_refused_by_name_with_its_range(field: str, value: float) -> None:
    option = "--" + field.replace("_", "-")
    with pytest.raises(ConfigurationError, match=f"{option} must be in .*, got {value}"):
        RelayConfig(**{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("bytes_per_s", float("nan")),
        ("burst_s", 0.0),
        ("joins_per_s", -1.0),
        ("joins_burst", 0.0),
        ("connections_per_address", 0),
        ("handshakes", 0),
    ],
)
def test_a_limit_out_of_range_is_refused_by_name_with_its_range(field: str, value: float) -> None:
    option = "--limits." + field.replace("_", "-")
    with pytest.raises(ConfigurationError, match=f"{option} must be in .*, got {value}"):
        LimitsConfig(**{field: value})  # type: ignore[arg-type]
