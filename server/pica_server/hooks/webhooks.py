"""Telling somebody else's server what happens in rooms: what is sent, signed how, and when again.

Pure. One delivery is under way at a time and the rest waits in order, so a receiver hears of a room
before it hears of who joined it. What fails is tried again after a while that doubles, spread by
chance; what cannot be delivered within ``give_up_s`` is dropped, and so is the oldest that waits
when too many do. Both are counted. A delivery may come twice: its ``id`` tells.
"""

import hashlib
import hmac
import json
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Final

FIRST_WAIT_S: Final = 0.5
LONGEST_WAIT_S: Final = 60.0
"""Before a delivery is tried again: doubles from the first to the longest, each shortened by chance
to between half and all of it (chosen: a receiver that restarts is back within seconds)."""
SIGNATURE_HEADER: Final = "Pica-Signature"
ID_HEADER: Final = "Pica-Event-Id"


@dataclass(frozen=True, kw_only=True, slots=True)
class RoomEvent:
    """Something that happened in a room. A peer that is away for a moment has not left."""

    event: str
    """``room_started``, ``room_ended``, ``peer_joined`` or ``peer_left``."""
    room: str
    peer_id: str = ""
    """Empty for events of the room."""
    identity: str = ""
    """Who it is for sure; empty without tokens."""
    name: str = ""
    """What they are called."""
    reason: str = ""
    """Why a peer left: ``left``, ``lost`` or ``removed``."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """One event on its way."""

    event_id: str
    body: bytes
    noted_s: float


def signature(secret: bytes, body: bytes, unix_s: int) -> str:
    """Return the value of the signature header: when it was signed, and HMAC-SHA256 of both.

    Signed is the time as text, a dot, and the body. A receiver computes the same, compares in
    constant time, and refuses what is older than some minutes.
    """
    code = hmac.new(secret, f"{unix_s}.".encode() + body, hashlib.sha256).hexdigest()
    return f"t={unix_s},v1={code}"


class WebhookQueue:
    """What waits to be delivered."""

    def __init__(
        self,
        *,
        max_waiting: int,
        give_up_s: float,
        new_id: Callable[[], str],
        random: Callable[[], float],
        counts: Counter[str],
    ) -> None:
        """Begin empty.

        Args:
            max_waiting: Events that may wait; one more drops the oldest.
            give_up_s: Seconds for which an event is worth telling.
            new_id: Makes ids that do not repeat.
            random: Returns numbers in [0, 1).
            counts: Where it counts ``delivered``, ``failed`` attempts, and events that were
                dropped: ``overflow``, ``expired``.
        """
        self._max_waiting = max_waiting
        self._give_up_s = give_up_s
        self._new_id = new_id
        self._random = random
        self._counts = counts
        self._waiting: deque[Delivery] = deque()
        self._under_way: Delivery | None = None
        self._wait_s = FIRST_WAIT_S
        self._not_before_s = 0.0

    def __len__(self) -> int:
        return len(self._waiting) + (self._under_way is not None)

    def offer(self, event: RoomEvent, *, unix_s: float, now: float) -> None:
        """Queue an event."""
        event_id = self._new_id()
        said = {key: value for key, value in asdict(event).items() if value}
        body = json.dumps({"id": event_id, "created": round(unix_s, 3), **said}).encode()
        self._waiting.append(Delivery(event_id, body, now))
        if len(self) > self._max_waiting:
            self._waiting.popleft()
            self._counts["overflow"] += 1

    def take(self, now: float) -> Delivery | None:
        """Take what is to be delivered now; ``delivered`` or ``failed`` follows."""
        if self._under_way is not None or now < self._not_before_s:
            return None
        while self._waiting and now - self._waiting[0].noted_s > self._give_up_s:
            self._waiting.popleft()
            self._counts["expired"] += 1
        if self._waiting:
            self._under_way = self._waiting.popleft()
        return self._under_way

    def delivered(self) -> None:
        """Note that what was taken has arrived."""
        self._under_way = None
        self._wait_s, self._not_before_s = FIRST_WAIT_S, 0.0
        self._counts["delivered"] += 1

    def failed(self, now: float) -> None:
        """Note that what was taken has not arrived: it is next again, after a while."""
        assert self._under_way is not None
        self._waiting.appendleft(self._under_way)
        self._under_way = None
        self._not_before_s = now + self._wait_s * (0.5 + 0.5 * self._random())
        self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)
        self._counts["failed"] += 1

    def next_timer(self) -> float | None:
        """Return when there is something to take, or None: nothing waits, or one is under way."""
        return self._not_before_s if self._waiting and self._under_way is None else None
