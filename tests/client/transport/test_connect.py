"""Where a link leads and under which name, what a refusal means, and where a relay may send it."""

import base64

import pytest

from pica_client.errors import OptionError
from pica_client.stats import summarise_ms, wire_bytes
from pica_client.transport.connect import LinkConfig, redirect_of, refusal_of, shown_name
from pica_protocol.errors import CloseCode
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit


def test_percentiles_are_samples_by_nearest_rank() -> None:
    assert summarise_ms([0.001 * n for n in range(1, 101)]) == {"p50": 50, "p95": 95, "p99": 99}
    assert summarise_ms([0.5]) == {"p50": 500, "p95": 500, "p99": 500}
    assert summarise_ms([]) == {"p50": None, "p95": None, "p99": None}


@pytest.mark.parametrize(
    ("message", "masked", "total"),
    [(125, False, 125 + 2 + 40), (126, True, 126 + 4 + 4 + 40), (65_536, True, 65_536 + 54)],
)
def test_the_wire_cost_counts_websocket_and_tcp_headers(
    message: int, masked: bool, total: int
) -> None:
    assert wire_bytes(message, is_masked=masked) == total


def test_a_name_is_taken_as_keyboards_of_all_scripts_write_it() -> None:
    assert LinkConfig(name="\u5c71\u7530\u3000\u592a\u90ce").name == "\u5c71\u7530 \u592a\u90ce"
    assert LinkConfig(name="Ada\u00a0L").name == "Ada L"
    assert LinkConfig(name="\u0645\u06cc\u200c\u0631").name == "\u0645\u06cc\u0631"
    with pytest.raises(OptionError, match="name must be printable"):
        LinkConfig(name="a\x00b")


@pytest.mark.parametrize("url", ["", "localhost:8765", "http://x:1", "ws://", "ws://x:99999"])
def test_a_url_that_is_no_relay_address_is_quoted(url: str) -> None:
    with pytest.raises(OptionError, match=r"is no relay address; write ws://HOST:PORT"):
        LinkConfig(url=url)


@pytest.mark.parametrize(("room", "name"), [("a b", "x"), ("", "x"), ("r", ""), ("r", "x" * 65)])
def test_a_room_or_name_beyond_its_limits_is_refused(room: str, name: str) -> None:
    with pytest.raises(OptionError, match=r"^(room|name) must"):
        LinkConfig(room=room, name=name)


@pytest.mark.parametrize(
    ("token", "name"),
    [
        ("", "guest"),
        ("h.eyJuYW1lIjoiQWRhIn0.s", "Ada"),
        ("h.e30.s", "guest"),
        ("h.eyJuYW1lIjo1fQ.s", "guest"),
        ("h.W10.s", "guest"),
        ("h.-.s", "guest"),
        ("h." + base64.urlsafe_b64encode(b"[" * 100_000).decode().rstrip("=") + ".s", "guest"),
        ("h", "guest"),
    ],
)
def test_the_name_of_a_join_token_is_the_one_that_is_shown(token: str, name: str) -> None:
    assert shown_name("guest", token) == name


@pytest.mark.parametrize("code", [CloseCode.FORBIDDEN, CloseCode.REMOVED, CloseCode.REPLACED])
def test_what_waiting_cannot_mend_is_final(code: CloseCode) -> None:
    refused = refusal_of("ws://a", Closed(code=code, reason="no", is_remote=True))
    assert refused is not None
    assert not refused.may_pass
    assert str(refused) == f"ws://a: the relay said no: no (code {code})"


def goodbye(url: str) -> Closed:
    return Closed(code=CloseCode.GOING_AWAY, reason="", is_remote=True, url=url)


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        ("wss://a.relays.example.org:8443", ""),
        ("wss://A.relays.example.org/pica/", ""),
        ("wss://b.relays.example.org/", ""),
        ("ws://192.0.2.1:9000", ""),
        ("ws://b.relays.example.org", "neither a host"),  # nothing proves that it is of the domain
        ("wss://a.relays.example.org/admin?reboot=1", "path"),
        ("ws://192.0.2.1/?reboot=1", "path"),
        ("wss://relays.example.org", "neither a host"),
        ("wss://evil.example", "neither a host"),
        ("wss://a.relays.example.org.evil.example", "neither a host"),
        ("ws://127.0.0.1:631", "neither a host"),
        ("ws://[::1]:8765", "neither a host"),
        ("ws://169.254.169.254/latest", "path"),
        ("wss://192.0.2.2", "neither a host"),
    ],
)
def test_a_redirect_leads_to_hosts_of_the_configuration_or_of_the_domain(
    target: str, complaint: str, caplog: pytest.LogCaptureFixture
) -> None:
    config = LinkConfig(url="wss://a.relays.example.org/pica", redirect_hosts=("192.0.2.1",))
    found = redirect_of(goodbye(target), "ws://192.0.2.1:8765", config)
    assert found == ("" if complaint else target)
    assert complaint in caplog.text


def test_names_without_a_domain_are_no_relatives_and_encryption_is_not_given_up() -> None:
    for target, url in (("wss://evil.org", "wss://relay.org"), ("wss://relay-b", "wss://relay-a")):
        assert not redirect_of(goodbye(target), url, LinkConfig(url=url))
    config = LinkConfig(url="wss://a.example.org", redirect_hosts=("192.0.2.1",))
    assert not redirect_of(goodbye("ws://192.0.2.1"), config.url, config)
