"""What the relay answers to plain HTTP: is it alive, is there a place, its numbers. Pure."""

from http import HTTPStatus
from typing import NamedTuple

from pica_server.config import RelayConfig
from pica_server.hub import Hub
from pica_server.loop_watch import WORST_S, LoopWatch
from pica_server.metrics import CONTENT_TYPE, metrics_text


class Page(NamedTuple):
    """One answer."""

    status: HTTPStatus
    text: str
    content_type: str = "text/plain; charset=utf-8"


class StatusPages:
    """The pages of one relay."""

    def __init__(self, hub: Hub, watch: LoopWatch, config: RelayConfig) -> None:
        self._hub = hub
        self._watch = watch
        self._config = config

    def answer(self, path: str, *, is_local: bool, now: float) -> Page | None:
        """Return the page of a path, or None if there is none.

        Args:
            path: Of the request.
            is_local: Whether it comes from this machine.
            now: The time.
        """
        match path:
            case "/healthz":
                worst_s = self._watch.worst_s(now)
                return _verdict(f"stalled for {worst_s:.1f} s" if worst_s >= WORST_S else "")
            case "/readyz":
                if self._hub.is_draining:
                    return _verdict("draining")
                is_full = self._hub.num_connections >= self._config.max_connections
                return _verdict("full" if is_full else "")
            case "/metrics" if is_local or self._config.open_metrics:
                return Page(HTTPStatus.OK, self._metrics(now), CONTENT_TYPE)
            case "/metrics":
                return Page(HTTPStatus.FORBIDDEN, "ask on this machine\n")
        return None

    def _metrics(self, now: float) -> str:
        hub = self._hub
        return metrics_text(
            hub.stats,
            {
                "open_connections": ("Connections that are open now.", hub.num_connections),
                "rooms": ("Rooms with somebody in them.", hub.num_rooms),
                "draining": ("1 while everybody is sent away.", float(hub.is_draining)),
                "waiting_frames": ("Frames that wait for receivers.", hub.num_waiting_frames),
                "waiting_control_bytes": (
                    "Bytes of control messages that wait for receivers.",
                    hub.num_waiting_control_bytes,
                ),
                "coalescing_seconds": ("How long frames wait for company.", hub.coalescing_s),
                "loop_lateness_seconds": (
                    "Worst delay of the event loop in ten seconds.",
                    self._watch.worst_s(now),
                ),
            },
        )


def _verdict(trouble: str) -> Page:
    if trouble:
        return Page(HTTPStatus.SERVICE_UNAVAILABLE, f"{trouble}\n")
    return Page(HTTPStatus.OK, "ok\n")
