"""Everything an operator may set, with unit and range."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pica_protocol.limits import MAX_PEERS, check_url
from pica_server.limits import is_loopback, networks

_ORIGIN = re.compile(r"https?://[^/?#\s]+")
_NATS_URL = re.compile(r"(nats|tls)://([^/?#\s@]+@)?[A-Za-z0-9._-]+(:[0-9]{1,5})?")


class ConfigurationError(ValueError):
    """A setting cannot work, or what it names cannot be used: names the setting and the fix."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class Range:
    """The least and the largest value of a setting; stands in the ``Annotated`` of its field."""

    low: float
    high: float


def check_ranges(config: Any, table: str = "") -> None:
    """Check every number of a group of settings against its range.

    Raises:
        ConfigurationError: One is outside; names its flag, in ``table``, the range and the value.
    """
    for name, hint in get_type_hints(type(config), include_extras=True).items():
        value = getattr(config, name)
        for mark in getattr(hint, "__metadata__", ()):
            if isinstance(mark, Range) and not (value is None or mark.low <= value <= mark.high):
                flag = f"--{table}{name}".replace("_", "-")
                raise ConfigurationError(f"{flag} must be in {mark.low}..{mark.high}, got {value}")


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitsConfig:
    """How much one client, one address and everybody together may ask of a relay."""

    bytes_per_s: Annotated[float, Range(1024, 1e12)] = 196_608.0
    """Bytes a second of one client, on average, and 512 for each frame and control message; 4008
    above it."""
    burst_s: Annotated[float, Range(0.1, 600)] = 15.0
    """So many seconds' worth may come at once, as after a pause of the relay or of a proxy, from a
    client that has been there for so long; one second's worth from one that has just come."""
    joins_per_s: Annotated[float, Range(0.1, 1e9)] = 50.0
    """Joins a second of everybody together, on average; 4009 above it."""
    joins_burst: Annotated[float, Range(1, 1e9)] = 200.0
    """Joins that may come at once, as when a relay starts again."""
    connections_per_address: Annotated[int, Range(1, 1_000_000)] = 64
    """Websockets of one address (of one /64 in IPv6); 4010 above it. This machine has no limit."""
    handshakes: Annotated[int, Range(1, 1_000_000)] = 256
    """Sockets that are not websockets yet; one more is cut without a word."""
    sockets_per_s: Annotated[float, Range(0.1, 1e9)] = 20.0
    """New sockets a second of one address (of one /64 in IPv6), on average, downloads among them;
    one more is cut before it costs a TLS handshake. This machine has no limit."""
    sockets_burst: Annotated[float, Range(1, 1e9)] = 200.0
    """New sockets of one address that may come at once, as when a relay starts again."""

    def __post_init__(self) -> None:
        check_ranges(self, "limits.")


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreConfig:
    """Limits of the avatar store."""

    quota_bytes: Annotated[int, Range(1, 2**50)] = 256 * 2**20
    """Bytes of all files together; 4015 above it."""
    largest_bytes: Annotated[int, Range(1024, 64 * 2**20)] = 16 * 2**20
    """Bytes of one file; 4015 above it."""
    max_avatars: Annotated[int, Range(1, 1_000_000)] = 10_000
    """Files in the store; 4015 above it."""
    grace_s: Annotated[float, Range(0.01, 600)] = 10.0
    """Seconds that every transfer may take."""
    slowest_bytes_per_s: Annotated[float, Range(1, 1e9)] = 8192.0
    """A transfer that takes longer than that and its size at this rate is cut."""
    uploads: Annotated[int, Range(1, 10_000)] = 8
    """At once, each in memory until it is whole; one more is told to come later (4009)."""
    uploads_per_address: Annotated[int, Range(1, 10_000)] = 2
    """At once; this machine has no limit."""
    downloads: Annotated[int, Range(1, 100_000)] = 64
    """At once; one more is told to come later (HTTP 503)."""
    downloads_per_address: Annotated[int, Range(1, 100_000)] = 16
    """At once; this machine has no limit."""

    def __post_init__(self) -> None:
        check_ranges(self, "store.")

    def longest_s(self, size: int) -> float:
        """How long a transfer of `size` bytes may take."""
        return self.grace_s + size / self.slowest_bytes_per_s


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayConfig:
    """Settings of one relay."""

    host: str = "127.0.0.1"
    """Address to listen on. Without keys it must be this machine's own, see `insecure`."""
    port: Annotated[int, Range(0, 65_535)] = 8765
    """TCP port; 0 takes a free one."""
    keys: Path | None = None
    """File of the keys that join tokens are signed with, see `pica token`. With it no one joins
    without a token."""
    insecure: bool = False
    """Without keys, listen beyond this machine although anybody who reaches the port may join any
    room."""
    tls_cert: Path | None = None
    """File with the certificate and those between it and a root, in PEM format: speaks TLS, so that
    clients write wss://. Read again every ten minutes; connections go on."""
    tls_key: Path | None = None
    """File with the private key of the certificate."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses or networks of proxies in front of this relay, as 10.0.0.0/8. What they say in
    X-Forwarded-For is used for the limits of one address, and for nothing else; and they may ask a
    relay that listens on this machine alone by any name."""
    origins: tuple[str, ...] = ()
    """Web pages that may connect, as https://HOST, besides the relay's own: a browser says where a
    page comes from. Programs say nothing, and may."""
    web: bool = True
    """Whether browsers are shown a page that joins rooms, at / and at the name of each room."""
    metrics_to: tuple[str, ...] = ()
    """Addresses or networks that /metrics is answered to besides this machine, as 10.0.0.0/8;
    0.0.0.0/0 is all."""
    avatar_store: str = "temporary"
    """Where avatar files are kept that clients give to each other: a folder; temporary, a folder
    that ends with the relay; none."""
    cluster: str = ""
    """Spread rooms over all relays with this NATS, as nats://HOST:4222; it needs JetStream. Several
    servers of one NATS cluster with commas between. See docs/operating.md."""
    public_url: str = ""
    """Where clients of other relays of the cluster reach this one, as wss://HOST:PORT; empty: where
    it listens."""
    room_capacity: Annotated[int, Range(1, MAX_PEERS)] = 16
    """Peers in one room."""
    max_connections: Annotated[int, Range(1, 1_000_000)] = 1024
    """Websockets in all, joined or not."""
    handshake_timeout_s: Annotated[float, Range(0.05, 600)] = 5.0
    """Seconds a client has to open the websocket, and then again to join."""
    stall_timeout_s: Annotated[float, Range(0.05, 600)] = 10.0
    """Seconds one message to a peer may wait for the peer to read before it is closed."""
    ping_interval_s: Annotated[float, Range(0.05, 600)] = 10.0
    """Seconds between the pings that find silent peers; a pong is due within the same time."""
    close_timeout_s: Annotated[float, Range(0.05, 600)] = 2.0
    """Seconds a closing handshake may take before the socket is cut."""
    resume_grace_s: Annotated[float, Range(0, 600)] = 10.0
    """Seconds for which the place of a peer is kept whose connection broke; 0 keeps none."""
    drain_s: Annotated[float, Range(0, 3600)] = 20.0
    """Seconds to send everybody away after SIGTERM, before the rest is cut; 0 cuts at once."""
    drain_to: str = ""
    """Address of the relay that they are sent to, as wss://HOST:PORT; empty: clients try this one's
    address again, where a load balancer may send them elsewhere."""
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    """What clients may ask for."""
    store: StoreConfig = field(default_factory=StoreConfig)
    """What the avatar store takes and gives."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.avatar_store:
            raise ConfigurationError("--avatar-store is empty; name a folder, or none")
        try:
            check_url("drain-to", self.drain_to)
            check_url("public-url", self.public_url)
        except ValueError as error:
            raise ConfigurationError(f"--{error}") from error
        for flag, names in (
            ("trusted-proxies", self.trusted_proxies),
            ("metrics-to", self.metrics_to),
        ):
            try:
                networks(names)
            except ValueError as error:
                raise ConfigurationError(
                    f"--{flag}: {error}; write addresses, or networks as 10.0.0.0/8"
                ) from error
        if (self.tls_cert is None) != (self.tls_key is None):
            given, lacking = ("cert", "key") if self.tls_key is None else ("key", "cert")
            raise ConfigurationError(f"--tls-{given} needs --tls-{lacking} beside it")
        for url in filter(None, self.cluster.split(",")):
            if not _NATS_URL.fullmatch(url):
                raise ConfigurationError("--cluster is no address of NATS: write nats://HOST:4222")
        if self.cluster and not self.public_url and not is_loopback(self.host):
            raise ConfigurationError(
                "--cluster redirects clients of other relays to this one: say where they reach it "
                "with --public-url wss://HOST:PORT"
            )
        for origin in self.origins:
            if not _ORIGIN.fullmatch(origin):
                raise ConfigurationError(f"--origins {origin} is no origin: write https://HOST")
        if self.keys is not None and self.insecure:
            raise ConfigurationError("--insecure lets anybody in: leave it out, or --keys")
        if self.keys is None and not self.insecure and not is_loopback(self.host):
            raise ConfigurationError(
                f"--host {self.host} can be reached from other machines and this relay has no "
                "tokens: name a key file with --keys (`pica token --keys FILE --new-key` makes "
                "one), keep --host 127.0.0.1, or add --insecure to let anybody in"
            )
