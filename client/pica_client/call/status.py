"""How the call stands and what its avatars cost, to be shown. Pure data."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pica_client.call.connection_quality import Quality, StreamHealth
from pica_client.call.participants import Participant
from pica_client.call.roster import News


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerStatus:
    """How one participant's stream comes in."""

    quality: Quality = "unknown"
    payload_bps: float | None = None
    """Bits a second over the last seconds; None before there were any."""
    health: StreamHealth = field(default_factory=StreamHealth)


@dataclass(frozen=True, kw_only=True, slots=True)
class CallStatus:
    """How the call stands."""

    is_connected: bool = True
    """Whether the relay has us in the room."""
    away_s: float = 0.0
    """How long it has not."""
    own_quality: Quality = "unknown"
    is_admin: bool = False
    """Whether our token lets us moderate the room."""
    muted_by_admin: str = ""
    """What an admin has stopped of our own: "face", "voice", both, or nothing."""
    own_trouble: str = ""
    """What is wrong with the tracker of our own face; empty: nothing, or there is none."""
    peers: Mapping[str, PeerStatus] = field(default_factory=dict)
    """How each stream comes in, by peer id."""
    participants: tuple[Participant, ...] = ()
    """Oneself, and everybody else in the order of coming."""
    news: tuple[News, ...] = ()
    """What happened since the last status."""
    room: str = ""
    """Where we are; empty outside a call."""
    invitation: str = ""
    """A line that leads others here."""
    is_encrypted: bool = False
    """Whether faces are encrypted end to end."""
    code: str = ""
    """Digits that everybody who sees the same people has, too; empty without encryption, and while
    no other member is verified."""
    duration_s: float = 0.0
    """Since we came in for the first time."""
    summary: tuple[tuple[str, str], ...] = ()
    """Further figures for the statistics, name and value."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarFigures:
    """What one avatar costs, over its latest frames."""

    level: int | None
    """Rows of the position map shown; None before the first."""
    decode_ms: float | None
    latency_ms: float | None
    """Time from the sender's sample to its decoded maps; meaningful on one machine only."""
    num_decoded: int
    is_speaking: bool
