"""A room of key exchanges without sockets: whispers take a moment, and may be lost, or come twice.

For tests of `pica_client.e2ee`; the real relay is in ``tests/call/test_voice.py``.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from pica_client.e2ee.guard import Guard
from pica_client.e2ee.secret import RoomSecret
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, Track, Whisper
from pica_protocol.session import ClientEvent

SECRET = RoomSecret(bytes(range(32)))
DELAY_S = 0.05

Whispered = tuple[str, str, bytes]
"""Sender, receiver, data."""


@dataclass
class Member:
    """One peer with its guard, and what came out of it."""

    guard: Guard
    peer: Peer
    joined: Joined
    sequence: int = 0
    frames: list[Frame] = field(default_factory=list)

    def take(self, events: list[ClientEvent]) -> None:
        self.frames += [event for event in events if isinstance(event, Frame)]


class Room:
    """Everybody, the clock, which `run` moves, and all whispers; `fate`: how often one arrives."""

    def __init__(self, fate: Callable[[Whispered], int] = lambda whispered: 1) -> None:
        self.now = 100.0
        self.whispers: list[Whispered] = []
        self.fate = fate
        self.members: dict[str, Member] = {}
        self._under_way: list[tuple[float, Whispered]] = []
        self._serial = 0

    def join(
        self,
        name: str,
        *,
        secret: RoomSecret = SECRET,
        publishes: bool = True,
        guard: Guard | None = None,
        asks_for: str = "r",
    ) -> Member:
        """Let somebody in; the name is the peer id."""
        self._serial += 1
        stream = self._serial
        tracks = (Track(kind="face", stream=stream),) if publishes else ()
        chance = random.Random(f"{name}/{self._serial}").randbytes
        guard = guard or Guard(secret, random_bytes=chance)
        others = tuple(member.peer for member in self.members.values())
        peer = Peer(peer_id=name, name=name, tracks=tracks)
        joined = Joined(room="r", peer_id=name, tracks=tracks, peers=others)
        member = Member(guard, peer, joined)
        guard.begin(asks_for, name)
        member.take(guard.receive_event(joined, self.now))
        for other in self.members.values():
            other.take(other.guard.receive_event(PeerJoined(peer=peer), self.now))
        self.members[name] = member
        return member

    def leave(self, name: str) -> Member:
        """Let somebody go."""
        member = self.members.pop(name)
        for other in self.members.values():
            other.take(other.guard.receive_event(PeerLeft(peer_id=name), self.now))
        return member

    def run(self, seconds: float) -> None:
        """Let time pass: whispers travel, timers fire."""
        end = self.now + seconds
        while True:
            self.flush()
            times = [arrival for arrival, _ in self._under_way]
            timers = [member.guard.next_timer() for member in self.members.values()]
            times += [max(timer, self.now) for timer in timers if timer is not None]
            if not times or min(times) > end:
                break
            self.now = max(self.now, min(times))
            arrived = [w for arrival, w in self._under_way if arrival <= self.now]
            self._under_way = [item for item in self._under_way if item[0] > self.now]
            for sender, receiver, data in arrived:
                self.deliver(sender, receiver, data)
        self.now = end

    def flush(self) -> None:
        """Send what the guards have to say."""
        for name, member in self.members.items():
            for receiver, data in member.guard.messages_to_send(self.now):
                whispered = (name, receiver, data)
                self.whispers.append(whispered)
                times = self.fate(whispered)
                self._under_way += [(self.now + DELAY_S, whispered)] * times

    def deliver(self, sender: str, receiver: str, data: bytes) -> None:
        """Hand over a whisper, if both are there."""
        if sender in self.members and receiver in self.members:
            member = self.members[receiver]
            member.take(member.guard.receive_event(Whisper(peer_id=sender, data=data), self.now))

    def seal(self, name: str, payload: bytes = b"face") -> Frame:
        """Make a sealed frame of somebody without sending it."""
        member = self.members[name]
        plain = Frame(
            stream=member.joined.tracks[0].stream,
            sequence=member.sequence % 65536,
            captured_us=round(self.now * 1e6),
            payload=payload,
        )
        member.sequence += 1
        sealed = replace(plain, payload=member.guard.seal(plain))
        return sealed

    def send(self, name: str, payload: bytes = b"face") -> Frame:
        """Send a frame to everybody at once, after the whispers that are due, as a link does."""
        sealed = self.seal(name, payload)
        self.flush()
        for sender, receiver, data in [whispered for _, whispered in self._under_way]:
            self.deliver(sender, receiver, data)
        self._under_way.clear()
        for other in self.members:
            if other != name:
                self.show(other, sealed)
        return sealed

    def show(self, name: str, frame: Frame) -> bool:
        """Hand a frame to somebody; say whether it opened."""
        member = self.members[name]
        before = len(member.frames)
        member.take(member.guard.receive_event(frame, self.now))
        return len(member.frames) > before


def full_room(*names: str) -> Room:
    """Everybody is there, has everybody's key, and has sent for a while."""
    room = Room()
    for name in names:
        room.join(name)
    room.run(2)
    for name in names:
        room.send(name)
    room.run(2)
    return room
