"""How a call stands, out of what receiver and call count: for the texts over the picture."""

from dataclasses import replace

from pica_client.call.connection_quality import Quality, QualityMeter, own_quality
from pica_client.call.roster import SELF_ID, Member
from pica_client.call.status import CallStatus
from pica_client.endpoint.endpoint import Receiver
from pica_client.playout.buffer import PlayoutReport
from pica_protocol.invite import Invite, make_link
from pica_protocol.messages import Peer

BUSY_RATIO = 0.05
"""Share of the time by which the timers of the network's thread are late on a machine that is too
busy to take frames as they come (chosen: 12 ms each; a calm machine has 1, and one with six
programs for each core 10 to 80)."""


class CallMonitor:
    """Watches a receiver."""

    def __init__(self, receiver: Receiver) -> None:
        self._receiver = receiver
        self._uplink = QualityMeter()
        self._before: tuple[float, float] | None = None  # when, and by how much timers were late
        self._away_since_s: float | None = None

    def status(self, now: float) -> CallStatus:
        """How the call stands at `now`, seconds; to be asked about twice a second."""
        receiver, link = self._receiver, self._receiver.link
        if receiver.is_connected:
            self._away_since_s = None
        elif self._away_since_s is None:
            self._away_since_s = now
        is_busy = self._is_busy(now)
        room = receiver.call.room(now, is_busy=is_busy)
        quality = [member.quality for member in room.members]
        return CallStatus(
            participants=(self._own(room.own_name), *room.members),
            news=room.news,
            room=link.config.room,
            invitation=invitation(link.config.url, link.config.room),
            is_encrypted=link.guard is not None,
            code="" if link.guard is None else link.guard.status.code,
            duration_s=room.duration_s,
            is_connected=receiver.is_connected,
            away_s=0.0 if self._away_since_s is None else now - self._away_since_s,
            own_quality=own_quality(quality, self._sent_quality(now, is_busy)),
            is_admin=link.is_admin,
            muted_by_admin=self._muted_by_admin,
            own_trouble="" if receiver.own.face is None else receiver.own.face.trouble,
            summary=self._summary(now, sum(each.payload_bps or 0.0 for each in room.members)),
        )

    def _is_busy(self, now: float) -> bool:
        """Return True if this machine was too busy, since the last look, to say how frames come."""
        late_s = self._receiver.late_s
        before_s, late_before_s = self._before or (now, late_s)
        self._before = now, late_s
        return late_s - late_before_s > BUSY_RATIO * (now - before_s)

    def _own(self, name: str) -> Member:
        """Ourselves, as the others see us."""
        link = self._receiver.link
        tracks = tuple(replace(track, stream=i) for i, track in enumerate(link.tracks, 1))
        return Member(
            peer=Peer(peer_id=SELF_ID, name=name, tracks=tracks, metadata=link.metadata),
            is_away=not self._receiver.is_connected,
            note="muted by an admin" if self._muted_by_admin else "",
        )

    @property
    def _muted_by_admin(self) -> str:
        own = {"face": self._receiver.own.face, "voice": self._receiver.own.voice}
        return " and ".join(kind for kind, each in own.items() if each and each.is_muted_by_admin)

    def _sent_quality(self, now: float, is_busy: bool) -> Quality:
        """How the network takes our own frames; unknown while we send none."""
        publisher, num_replaced = self._receiver.own.face, self._receiver.link.num_replaced
        if publisher is None or not self._receiver.is_connected:
            return self._uplink.pause()
        if is_busy:
            return self._uplink.skip()
        num_sent = max(publisher.num_sent - num_replaced, 0)
        return self._uplink.receive(PlayoutReport(received=num_sent, lost=num_replaced), now)

    def _summary(self, now: float, bps: float) -> tuple[tuple[str, str], ...]:
        stats = self._receiver.stats(now)
        delay_ms = max((peer["playout_delay_ms"] for peer in stats["peers"]), default=0.0)
        return (
            ("relay", "connected" if self._receiver.is_connected else "away"),
            ("in", f"{bps / 1e3:.1f} kbit/s"),
            ("playout", f"{delay_ms:.0f} ms"),
            ("lost", str(stats["dropped"])),
            ("errors", str(stats["errors"])),
        )


def invitation(url: str, room: str) -> str:
    """A link that leads to a room; whom a relay wants a token of needs one of their own."""
    return make_link(Invite(url=url, room=room))
