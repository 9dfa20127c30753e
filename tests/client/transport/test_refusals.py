"""When a refusal ends a link, and where a link lets a relay send it."""

from __future__ import annotations

import pytest

from pica_client.transport.connect import LinkConfig, refusal_of, refused_redirect
from pica_protocol.errors import CloseCode
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("code", [CloseCode.FORBIDDEN, CloseCode.REMOVED, CloseCode.REPLACED])
def test_what_waiting_cannot_mend_is_final(code: CloseCode) -> None:
    refused = refusal_of("ws://a", Closed(code=code, reason="no", is_remote=True))
    assert refused is not None
    assert not refused.may_pass
    assert str(refused) == f"ws://a: the relay said no: no (code {code})"


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
    target: str, complaint: str
) -> None:
    config = LinkConfig(url="wss://a.relays.example.org/pica", redirect_hosts=("192.0.2.1",))
    refused = refused_redirect(target, "ws://192.0.2.1:8765", config)
    assert complaint in refused
    assert bool(complaint) is bool(refused)


def test_names_without_a_domain_are_no_relatives_and_encryption_is_not_given_up() -> None:
    for target, url in (("wss://evil.org", "wss://relay.org"), ("wss://relay-b", "wss://relay-a")):
        assert refused_redirect(target, url, LinkConfig(url=url))
    config = LinkConfig(url="wss://a.example.org", redirect_hosts=("192.0.2.1",))
    refused = refused_redirect("ws://192.0.2.1", config.url, config)
    assert refused == "connections are not encrypted there"
