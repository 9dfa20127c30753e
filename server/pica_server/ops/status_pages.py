"""What the relay answers to plain HTTP: is it alive, is there a place, its numbers. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from typing import Final

from pica_server.config.relay import RelayConfig
from pica_server.room.forwarding import CALM_S
from pica_server.room.hub import Hub
from pica_server.stats import CONTENT_TYPE, metrics_text
from pica_server.store.store import AvatarStore

WORST_S: Final = 1.0
"""A timer later than this means that everybody's face froze for a second."""


@dataclass(frozen=True, slots=True)
class Page:
    """What is answered to a plain HTTP request."""

    status: HTTPStatus
    text: str
    content_type: str = "text/plain; charset=utf-8"
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(eq=False)
class StatusPages:
    """The pages of one relay."""

    _hub: Hub
    _config: RelayConfig
    _store: AvatarStore | None = None

    def answer(self, path: str, *, is_local: bool, now: float) -> Page | None:
        """Return the page of a path, or None if there is none; ``/metrics`` is for this machine."""
        match path:
            case "/healthz":
                worst_s = self._hub.overload.worst_s(now)
                trouble = f"stalled for {worst_s:.1f} s" if worst_s >= WORST_S else ""
                # No reason to start it again: its rooms go on, and it comes back by itself.
                return _verdict(trouble, self._placement_trouble)
            case "/readyz":
                if self._hub.connections.is_draining:
                    return _verdict("draining")
                if self._hub.overload.refuses(now):
                    page = _verdict("late, no new peers are admitted")
                    return replace(page, headers={"Retry-After": f"{CALM_S:.0f}"})
                is_full = self._hub.num_connections >= self._config.max_connections
                return _verdict("full" if is_full else "", self._placement_trouble)
            case "/metrics" if is_local:
                return Page(HTTPStatus.OK, self._metrics(now), CONTENT_TYPE)
            case "/metrics":
                return Page(HTTPStatus.FORBIDDEN, "ask on this machine\n")
        return None

    @property
    def _placement_trouble(self) -> str:
        placement = self._hub.membership.placement
        return "" if placement is None or placement.is_up else "NATS lost, new rooms are local"

    def _metrics(self, now: float) -> str:
        hub = self._hub
        placement = hub.membership.placement
        num_relays = 0 if placement is None else placement.num_relays
        is_up = placement is not None and placement.is_up
        store = self._store
        used_bytes, num_free_bytes = (store.used_bytes, store.num_free_bytes) if store else (0, 0)
        gauges = {
            "avatars": store.num_avatars if store else 0,
            "avatar_store_bytes": used_bytes,
            "avatar_store_free_bytes": num_free_bytes,
            "placement_up": is_up,
            "placement_relays": num_relays,
            "open_connections": hub.num_connections,
            "rooms": hub.num_rooms,
            "draining": hub.connections.is_draining,
            "overload": hub.overload.refuses(now),
            "loop_lateness_seconds": hub.overload.worst_s(now),
        }
        return metrics_text(hub.stats, gauges)


def _verdict(trouble: str, note: str = "") -> Page:
    if trouble:
        return Page(HTTPStatus.SERVICE_UNAVAILABLE, f"{trouble}\n")
    return Page(HTTPStatus.OK, f"ok\n{note}\n" if note else "ok\n")
