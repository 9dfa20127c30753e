"""One websocket as the hub sees it: its session, its outbox, and what it may still send. Pure."""

import math

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


class Connection:
    """One websocket as the hub sees it; the shell reads ``closed``."""

    __slots__ = (
        "address",
        "bytes_in",
        "has_joined",
        "held_s",
        "is_crowded",
        "is_resumable",
        "messages_in",
        "outbox",
        "peer_id",
        "room",
        "sending_since",
        "serial",
        "session",
        "updates",
        "whispers",
    )

    def __init__(
        self,
        serial: int,
        session: ServerSession,
        outbox: Outbox,
        limits: LimitsConfig,
        address: str,
        now: float,
    ) -> None:
        # What piled up while the relay or the way to it stood still was sent at a good rate: who
        # has been here for so long may send that much at once. Who has just come has saved nothing.
        messages, num_bytes, burst_s = limits.messages_per_s, limits.bytes_per_s, limits.burst_s
        self.messages_in = TokenBucket(messages, messages * burst_s, now, messages)
        self.bytes_in = TokenBucket(num_bytes, num_bytes * burst_s, now, num_bytes)
        self.address = address
        self.has_joined = False
        self.held_s = math.inf  # when what waits for more to come goes at the latest
        self.serial = serial
        self.session = session
        self.outbox = outbox
        self.room: Room | None = None
        self.peer_id = f"p{serial}"
        self.sending_since: float | None = None
        self.is_crowded = False  # one more than its address may have
        self.is_resumable = False
        self.updates = TokenBucket(UPDATES_PER_S, UPDATES_BURST, now)
        self.whispers = TokenBucket(WHISPERS_PER_S, WHISPER_BURST, now)

    @property
    def closed(self) -> Closed | None:
        """How it ended, or None."""
        return self.session.closed
