"""One websocket as the hub sees it: its session, its outbox, and what it may still send. Pure."""

from dataclasses import InitVar, dataclass, field

from pica_protocol.server_session import ServerSession
from pica_protocol.session import Closed
from pica_server.config.relay import LimitsConfig
from pica_server.net.limits import TokenBucket
from pica_server.room.outbox import Outbox
from pica_server.room.room import Room

WHISPERS_PER_S = 16.0
WHISPER_BURST = 128.0
"""What one peer may whisper: two rounds to everybody in the largest room at once, and then a round
in four seconds (chosen: keys change when somebody comes or goes)."""

UPDATES_PER_S = 1.0
UPDATES_BURST = 10.0
"""How often one peer may say something else of itself (chosen: people raise a hand; with 700 bytes
for each, one peer alone does not fill the queues of slow readers)."""


MODERATIONS_PER_S = 2.0
MODERATIONS_BURST = 64.0
"""What one admin may ask for: everybody in the largest room at once, and then a participant in half
a second (chosen: each one is told to the whole room)."""


@dataclass(eq=False, slots=True)
class Connection:
    """One websocket as the hub sees it; the shell reads ``closed``."""

    serial: int
    session: ServerSession
    outbox: Outbox
    limits: InitVar[LimitsConfig]
    address: str
    now: InitVar[float]
    peer_id: str
    messages_in: TokenBucket = field(init=False)
    bytes_in: TokenBucket = field(init=False)
    updates: TokenBucket = field(init=False)
    whispers: TokenBucket = field(init=False)
    moderations: TokenBucket = field(init=False)
    has_joined: bool = False
    room: Room | None = None
    sending_since: float | None = None
    is_crowded: bool = False
    """One more than its address may have."""
    is_resumable: bool = False
    is_admin: bool = False
    """Whether its token has the grant ``admin``."""

    def __post_init__(self, limits: LimitsConfig, now: float) -> None:
        # What piled up while the relay or the way to it stood still was sent at a good rate: who
        # has been here for so long may send that much at once. Who has just come has saved nothing.
        messages, num_bytes, burst_s = limits.messages_per_s, limits.bytes_per_s, limits.burst_s
        self.messages_in = TokenBucket(messages, messages * burst_s, now, messages)
        self.bytes_in = TokenBucket(num_bytes, num_bytes * burst_s, now, num_bytes)
        self.updates = TokenBucket(UPDATES_PER_S, UPDATES_BURST, now)
        self.whispers = TokenBucket(WHISPERS_PER_S, WHISPER_BURST, now)
        self.moderations = TokenBucket(MODERATIONS_PER_S, MODERATIONS_BURST, now)

    @property
    def closed(self) -> Closed | None:
        """How it ended, or None."""
        return self.session.closed
