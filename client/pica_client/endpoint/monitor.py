"""How a call stands, out of what receiver and call count: for the texts over the picture."""

from collections.abc import Mapping

from pica_client.call.connection_quality import (
    Quality,
    QualityMeter,
    StreamHealth,
    own_quality,
)
from pica_client.call.status import CallStatus, PeerStatus, Person, list_participants
from pica_client.endpoint.endpoint import Receiver
from pica_protocol.invite import Invite, make_link

BUSY_RATIO = 0.05
"""Share of the time by which the timers of the network's thread are late on a machine that is too
busy to take frames as they come (chosen: 12 ms each; a calm machine has 1, and one with six
programs for each core 10 to 80)."""


class CallMonitor:
    """Watches a receiver; keeps a quality meter for each peer."""

    def __init__(self, receiver: Receiver) -> None:
        self._receiver = receiver
        self._meters: dict[str, QualityMeter] = {}
        self._before: tuple[float, dict[str, StreamHealth]] | None = None
        self._uplink = QualityMeter()
        self._late_before_s = 0.0
        self._away_since_s: float | None = None

    def status(self, now: float) -> CallStatus:
        """How the call stands at `now`, seconds; to be asked about twice a second."""
        receiver = self._receiver
        if receiver.is_connected:
            self._away_since_s = None
        elif self._away_since_s is None:
            self._away_since_s = now
        health, is_busy = receiver.call.health(), self._is_busy(now)
        self._meters = {peer_id: self._meters.get(peer_id) or QualityMeter() for peer_id in health}
        quality = {
            peer_id: meter.skip() if is_busy else meter.receive(health[peer_id], now)
            for peer_id, meter in self._meters.items()
        }
        before_s, before = self._before or (now, {})
        peers = {
            peer_id: PeerStatus(
                quality=quality[peer_id],
                payload_bps=_bits_per_s(before.get(peer_id), found, now - before_s),
                health=found,
            )
            for peer_id, found in health.items()
        }
        if self._before is None or now > before_s:
            self._before = (now, health)
        room, guard = receiver.call.room(now), receiver.link.guard
        return CallStatus(
            participants=list_participants(self._own(room.own_name), room, quality),
            news=room.news,
            room=receiver.link.config.room,
            invitation=invitation(receiver.link.config.url, receiver.link.config.room),
            is_encrypted=guard is not None,
            code="" if guard is None else guard.status.code,
            duration_s=room.duration_s,
            is_connected=receiver.is_connected,
            away_s=0.0 if self._away_since_s is None else now - self._away_since_s,
            own_quality=own_quality(list(quality.values()), self._sent_quality(now, is_busy)),
            is_admin=receiver.link.is_admin,
            muted_by_admin=self._muted_by_admin,
            own_trouble="" if receiver.own.face is None else receiver.own.face.trouble,
            peers=peers,
            summary=self._summary(now, peers),
        )

    def _is_busy(self, now: float) -> bool:
        """Return True if this machine was too busy, since the last look, to say how frames come."""
        late_s, before_s = self._receiver.late_s, self._before[0] if self._before else now
        late_before_s, self._late_before_s = self._late_before_s, late_s
        return late_s - late_before_s > BUSY_RATIO * (now - before_s)

    def _own(self, name: str) -> Person:
        """Ourselves, as the others see us."""
        publisher, voice = self._receiver.own.face, self._receiver.own.voice
        return Person(
            peer_id="",
            name=name,
            is_self=True,
            is_watching=publisher is None,
            is_away=not self._receiver.is_connected,
            is_recording=self._receiver.is_recording,
            face="sent" if publisher is None else publisher.mode,
            has_voice=voice is not None,
            is_voice_muted=voice is not None and voice.is_muted,
            note="muted by an admin" if self._muted_by_admin else "",
        )

    @property
    def _muted_by_admin(self) -> str:
        own = {"face": self._receiver.own.face, "voice": self._receiver.own.voice}
        return " and ".join(kind for kind, each in own.items() if each and each.is_muted_by_admin)

    def _sent_quality(self, now: float, is_busy: bool) -> Quality:
        """How the network takes our own frames; unknown while we send none."""
        publisher, num_replaced = self._receiver.own.face, self._receiver.link.num_replaced
        if publisher is None:
            return "unknown"
        if is_busy:
            return self._uplink.skip()
        health = StreamHealth(
            received=max(publisher.num_sent - num_replaced, 0),
            lost=num_replaced,
            is_paused=not self._receiver.is_connected,
        )
        return self._uplink.receive(health, now)

    def _summary(self, now: float, peers: Mapping[str, PeerStatus]) -> tuple[tuple[str, str], ...]:
        stats = self._receiver.stats(now)
        bits = sum(peer.payload_bps or 0.0 for peer in peers.values()) / 1e3
        delay_ms = max((peer["playout_delay_ms"] for peer in stats["peers"]), default=0.0)
        refused = sum(peer["refused"] for peer in stats["peers"])
        return (
            ("relay", "connected" if self._receiver.is_connected else "away"),
            ("in", f"{bits:.1f} kbit/s"),
            ("playout", f"{delay_ms:.0f} ms"),
            ("lost", str(stats["dropped"])),
            ("refused", str(refused)),
            ("errors", str(stats["errors"])),
        )


def invitation(url: str, room: str) -> str:
    """A link that leads to a room; whom a relay wants a token of needs one of their own."""
    return make_link(Invite(url=url, room=room))


def _bits_per_s(before: StreamHealth | None, after: StreamHealth, elapsed_s: float) -> float | None:
    if before is None or elapsed_s <= 0 or after.payload_bytes < before.payload_bytes:
        return None
    return (after.payload_bytes - before.payload_bytes) * 8 / elapsed_s
