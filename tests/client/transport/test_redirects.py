import pytest

from pica_client.transport.redirects import refused_redirect

pytestmark = pytest.mark.unit

OURS = ("wss://a.relays.example.org/pica", "ws://192.0.2.1:8765")


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        ("wss://a.relays.example.org:8443", ""),
        ("wss://A.relays.example.org/pica/", ""),
        ("wss://b.relays.example.org/", ""),
        ("ws://192.0.2.1:9000", ""),
        ("ws://b.relays.example.org", "neither a host"),  # nobody proves that it is of the domain
        ("wss://a.relays.example.org/admin?reboot=1", "path"),
        ("ws://192.0.2.1/cgi-bin/reboot", "path"),
        ("ws://192.0.2.1/?reboot=1", "path"),
        ("wss://relays.example.org", "neither a host"),
        ("wss://evil.example", "neither a host"),
        ("wss://a.relays.example.org.evil.example", "neither a host"),
        ("ws://127.0.0.1:631", "neither a host"),
        ("ws://localhost", "neither a host"),
        ("ws://[::1]:8765", "neither a host"),
        ("ws://192.168.1.1", "neither a host"),
        ("ws://169.254.169.254/latest", "path"),
        ("wss://1.0.2.1", "neither a host"),
        ("wss://192.0.2.2", "neither a host"),
    ],
)
def test_a_relay_sends_us_nowhere_but_to_hosts_that_we_know_or_their_kin(
    target: str, complaint: str
) -> None:
    refused = refused_redirect(target, "ws://192.0.2.1:8765", OURS)
    assert complaint in refused
    assert bool(complaint) is bool(refused)


def test_names_without_a_domain_are_no_kin_and_encryption_is_not_given_up() -> None:
    assert refused_redirect("wss://evil.org", "wss://relay.org", ["wss://relay.org"])
    assert refused_redirect("wss://relay-b", "wss://relay-a", ["wss://relay-a"])
    refused = refused_redirect("ws://192.0.2.1", "wss://a.relays.example.org", OURS)
    assert refused == "connections are not encrypted there"
