"""Members of a call against its other members, on the relay without its sockets.

Three people talk in a room with keys: Ada, Ben, and Cho, whose line carries 160 kbit/s. One or two
others have tokens of their own, no manners, and a few tricks out of `TRICKS`, drawn for each run.
After every run this must hold for Ada, Ben and Cho:

    no starving         the others' voices and faces came, at least as many as `LEAST` says
    no muting           no stream was stopped, and no other member was closed
    no relabelling      a frame on Ada's stream is one that Ada sent; her name and identity are hers
    no outliving        a member that left is gone for the others, and sends nothing any more
"""

from __future__ import annotations

import random
from collections import Counter, defaultdict
from collections.abc import Callable

from fuzzing.damage import BOMBS
from golden.wire_samples import invalid_bytes, wire_bytes
from helpers.members import FACE, VOICE
from malice.people import BrokenPromiseError
from pica_protocol.client_session import ClientSession, Ticket
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import SEQUENCE_MODULUS, Frame, encode_frame, media_message
from pica_protocol.messages import (
    BarIdentity,
    Join,
    MutePeer,
    PeerLeft,
    RemovePeer,
    Subscribe,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import Closed, State
from pica_server.config import RelayConfig
from pica_server.limits import RefusalError
from pica_server.room.connections import Connection
from pica_server.room.hub import Hub
from pica_server.room.outbox import OutboundMessage
from pica_server.tokens import Admission

STEP_S = 1 / 50
SECONDS = 2.0
GRACE_S = 0.5
MESSAGE_BYTES = 44
"""What surrounds a message on its line."""
LINES_BYTES_PER_S = {"ada": 1e9, "ben": 1e9, "cho": 20_000}
LEAST = {1e9: (0.99, 0.99), 20_000: (0.85, 0.3)}
"""Voices and faces that come through a line, of all that were sent. Cho's line has room for the
voices of all and for a part of the faces."""
MESSAGES = [each for each in (*wire_bytes().values(), *invalid_bytes().values(), *BOMBS) if each]
"""What damaged messages are made of."""
CONFIG = RelayConfig(resume_grace_s=GRACE_S, room_capacity=8)


def admitted(join: Join) -> Admission:
    """Let in any peer that gives a name as the token."""
    if join.token in LINES_BYTES_PER_S or join.token.startswith("eve"):
        return Admission(identity=join.token, name=join.token.title())
    raise RefusalError("no token", CloseCode.UNAUTHORIZED)


class Friend:
    """A member who behaves, and who notes what comes."""

    def __init__(self, hub: Hub, name: str, now: float) -> None:
        self.hub, self.name = hub, name
        self.line_bytes_per_s = LINES_BYTES_PER_S[name]
        self.connection = hub.connect(now, name)
        tracks = (FACE, VOICE)
        self.session = ClientSession(room="lobby", name=name, tracks=tracks, now=now, token=name)
        self.sent: Counter[str] = Counter()
        self.came: Counter[tuple[str, str]] = Counter()
        self.left: dict[str, float] = {}
        self._line_bytes = 0.0
        self._under_way: OutboundMessage | None = None
        self._speak(now)

    def publish(self, step: int, now: float) -> None:
        """Send a face at 25 frames a second, and as many packets of voice."""
        kind = ("face", "voice")[step % 2]
        self.sent[kind] += 1
        payload = f"{self.name} {kind} {step}".encode().ljust((24, 90)[step % 2])
        self.session.send_frame(payload, round(now * 1e6), track=step % 2)
        self._speak(now)

    def read(self, now: float) -> None:
        """Read what the line has carried."""
        self._line_bytes = min(self._line_bytes + self.line_bytes_per_s * STEP_S, 1e6)
        while message := self._under_way or self.hub.take(self.connection, now):
            size = len(message.data) + MESSAGE_BYTES
            if size > self._line_bytes:
                if self._under_way is None:
                    self.hub.is_sending(self.connection, now)
                self._under_way = message
                return
            self._line_bytes -= size
            self._under_way = None
            self.hub.sent(self.connection, message, now)
            for event in self.session.receive_data(message.data, now):
                self._note(event, now)
        self._line_bytes = min(self._line_bytes, self.line_bytes_per_s * STEP_S)

    def _note(self, event: object, now: float) -> None:
        if isinstance(event, PeerLeft):
            self.left[event.peer_id] = now
        if isinstance(event, Closed):
            raise BrokenPromiseError(f"{self.name} had to go: {event.reason}")
        if isinstance(event, Frame):
            self._note_frame(event)

    def _note_frame(self, frame: Frame) -> None:
        owners = [
            peer
            for peer in self.session.peers.values()
            if frame.stream in [track.stream for track in peer.tracks]
        ]
        if len(owners) != 1:
            raise BrokenPromiseError(f"a frame on stream {frame.stream} of {len(owners)} peers")
        who, words = owners[0].identity, frame.payload.split()
        is_friend = who in LINES_BYTES_PER_S
        if (owners[0].name, is_friend) != (who.title(), words[:1] == [who.encode()]):
            raise BrokenPromiseError(f"{who}, called {owners[0].name}, sent {frame.payload!r}")
        self.came[who, words[1].decode() if is_friend else ""] += 1

    def _speak(self, now: float) -> None:
        for data in self.session.messages_to_send(now):
            self.hub.receive(self.connection, [data], now)


class Foe:
    """A member who has a token and tries what others do not."""

    def __init__(self, hub: Hub, name: str, rng: random.Random) -> None:
        self.hub, self.name, self.rng = hub, name, rng
        self.tricks = rng.sample(TRICKS, rng.randint(1, 3))
        self.connections: list[Connection] = []
        self.session: ClientSession | None = None
        self.ticket: Ticket | None = None
        self.heard: list[Frame] = []
        self.reads = rng.random() < 0.7

    def act(self, now: float) -> None:
        """Come in, read perhaps, and try something."""
        if self.session is None or self.session.closed is not None:
            if self.rng.random() < 0.06:
                join(self, now)
            return
        if self.reads:
            self.read(now)
        if self.session.state is State.JOINED:
            self.rng.choice(self.tricks)(self, now)

    def read(self, now: float) -> None:
        """Take what waits for the newest connection."""
        assert self.session is not None
        connection = self.connections[-1]
        while message := self.hub.take(connection, now):
            self.hub.sent(connection, message, now)
            events = self.session.receive_data(message.data, now)
            self.heard += [event for event in events if isinstance(event, Frame)]
        del self.heard[:-20]

    def say(self, data: bytes, now: float) -> None:
        """Send a message on the newest connection, as it is."""
        self.hub.receive(self.connections[-1], [data], now)

    def tell(self, message: object, now: float) -> None:
        """Send a control message."""
        self.say(encode_message(message), now)  # type: ignore[arg-type]

    def victim(self) -> str:
        """The peer id of a member, or one that is often dealt."""
        assert self.session is not None
        return self.rng.choice([*self.session.peers, "p1", "p2", "p3"])

    def flush(self, now: float) -> None:
        """Send what the session has to say."""
        assert self.session is not None
        for data in self.session.messages_to_send(now):
            self.say(data, now)

    def frame(self, stream: int, payload: bytes, now: float) -> bytes:
        """A frame of any stream."""
        sequence = self.rng.randrange(SEQUENCE_MODULUS)
        captured_us = round(now * 1e6) if self.rng.random() < 0.5 else self.rng.randrange(2**40)
        frame = Frame(stream=stream, sequence=sequence, captured_us=captured_us, payload=payload)
        return encode_frame(frame)


def join(foe: Foe, now: float, *, token: str | None = None, ticket: Ticket | None = None) -> None:
    """Come in, perhaps under the name of another member."""
    tracks = foe.rng.choice(((FACE, VOICE), (FACE,) * 4, (VOICE,) * 4, ()))
    foe.connections.append(foe.hub.connect(now, foe.name))
    foe.session = ClientSession(
        room=foe.rng.choice(("lobby",) * 5 + ("attic",)),
        name=foe.rng.choice(("Ada", "Ben", "Eve")),
        tracks=tracks,
        now=now,
        token=foe.name if token is None else token,
        resumable=foe.rng.random() < 0.8,
        ticket=ticket,
    )
    foe.flush(now)
    foe.read(now)
    foe.ticket = foe.session.ticket or foe.ticket


def flood(foe: Foe, now: float) -> None:
    """Send as much as the relay lets through, on every track."""
    assert foe.session is not None
    size = foe.rng.choice((1, 24, 90, 300, 1180))
    for track in foe.session.tracks:
        for _ in range(foe.rng.choice((1, 2, 8, 40))):
            foe.say(media_message([foe.frame(track.stream, b"eve" + bytes(size), now)]), now)


def send_on_other_streams(foe: Foe, now: float) -> None:
    """Send on a stream of another member, or of none; alone or behind an own frame."""
    assert foe.session is not None
    own = [track.stream for track in foe.session.tracks]
    streams = foe.rng.sample([*own, 1, 2, 3, 4, foe.rng.randrange(1, 65_536)], 2)
    foe.say(media_message([foe.frame(stream, b"eve", now) for stream in streams]), now)


def replay(foe: Foe, now: float) -> None:
    """Send a frame of another member once more."""
    assert foe.session is not None
    if foe.heard and foe.session.tracks:
        frame = foe.rng.choice(foe.heard)
        stream = foe.rng.choice((frame.stream, foe.session.tracks[0].stream))
        payload = b"eve" + frame.payload[:1000] if stream != frame.stream else frame.payload
        foe.say(media_message([foe.frame(stream, payload, now)]), now)


def whisper(foe: Foe, now: float) -> None:
    """Whisper a lot."""
    for _ in range(foe.rng.choice((1, 20))):
        foe.tell(Whisper(peer_id=foe.victim(), data=foe.rng.randbytes(500)), now)


def subscribe(foe: Foe, now: float) -> None:
    """Want streams and not want them."""
    for _ in range(foe.rng.choice((1, 20))):
        stream = foe.rng.randrange(1, 12)
        foe.tell(Subscribe(stream=stream, every=foe.rng.choice((0, 1, 2, 4))), now)


def change_metadata(foe: Foe, now: float) -> None:
    """Say something else, in the worst case of others' keys."""
    value = foe.rng.choice(("muted", "lost", "x" * 64))
    foe.tell(UpdateMetadata(metadata=(("face", value), ("voice", value))), now)


def moderate(foe: Foe, now: float) -> None:
    """Ask for what only admins may."""
    requests = (
        RemovePeer(peer_id=foe.victim()),
        MutePeer(peer_id=foe.victim(), kind="voice", is_muted=True),
        BarIdentity(identity="ada", is_barred=True),
    )
    foe.tell(foe.rng.choice(requests), now)


def lose_connection(foe: Foe, now: float) -> None:
    """Lose the connection and come back, with one's ticket, an old one or none."""
    foe.hub.disconnect(foe.connections[-1], 1006, "", now)
    if foe.rng.random() < 0.7:
        join(foe, now, ticket=foe.ticket)
    else:
        foe.session = None


def join_beside(foe: Foe, now: float) -> None:
    """Join once more beside oneself, now and then without a token."""
    join(foe, now, token=foe.rng.choice((foe.name, foe.name, "", "mallory")), ticket=foe.ticket)


def send_damaged(foe: Foe, now: float) -> None:
    """Send a message that is none."""
    data = bytearray(foe.rng.choice(MESSAGES))
    for _ in range(foe.rng.randint(1, 4)):
        data[foe.rng.randrange(len(data))] = foe.rng.randrange(256)
    foe.say(bytes(data[: foe.rng.choice((len(data), foe.rng.randrange(1, len(data) + 1)))]), now)


def join_again(foe: Foe, now: float) -> None:
    """Join again inside of the room."""
    foe.tell(Join(room="lobby", name="Ada", token=foe.name), now)


def stop_reading(foe: Foe, now: float) -> None:
    """Read nothing from now on, while asking for everything."""
    foe.reads = False
    foe.hub.is_sending(foe.connections[-1], now)


def do_nothing(foe: Foe, now: float) -> None:
    """Wait."""


TRICKS: list[Callable[[Foe, float], None]] = [
    flood,
    flood,
    send_on_other_streams,
    replay,
    whisper,
    subscribe,
    change_metadata,
    moderate,
    lose_connection,
    join_beside,
    send_damaged,
    join_again,
    stop_reading,
    do_nothing,
]


def run(seed: int) -> Counter[str]:
    """Hold one call.

    Returns:
        What was tried, by trick, and with which codes the foes were closed.

    Raises:
        BrokenPromiseError: Something happened that must not; says the seed.
    """
    rng = random.Random(seed)
    hub = Hub(CONFIG, admitted, new_secret=lambda: f"{rng.getrandbits(128):032x}")
    now = 100.0
    friends = [Friend(hub, name, now) for name in LINES_BYTES_PER_S]
    foes = [Foe(hub, f"eve{index}", rng) for index in range(rng.randint(1, 2))]
    counts: Counter[str] = Counter(trick.__name__ for foe in foes for trick in foe.tricks)
    try:
        for step in range(round((SECONDS + 2 * GRACE_S) / STEP_S)):
            now += STEP_S
            for foe in foes if step * STEP_S < SECONDS else ():
                foe.act(now)
            if step == round(SECONDS / STEP_S):
                counts += _leave(hub, foes, now)
            for friend in friends:
                if step >= 10:
                    friend.publish(step, now)
            for friend in friends:
                friend.read(now)
            hub.handle_timer(now)
            hub.take_ready()
        _check(hub, friends)
    except BrokenPromiseError as error:
        tricks = [[trick.__name__ for trick in foe.tricks] for foe in foes]
        raise BrokenPromiseError(f"seed {seed}, {tricks}: {error}") from error
    return counts


def _leave(hub: Hub, foes: list[Foe], now: float) -> Counter[str]:
    codes: Counter[str] = Counter()
    for connection in [connection for foe in foes for connection in foe.connections]:
        hub.disconnect(connection, 1006, "", now)
        assert connection.closed is not None
        codes[f"closed {connection.closed.code}"] += 1
    return codes


def _check(hub: Hub, friends: list[Friend]) -> None:
    """Hold what the friends saw against the promises."""
    names = {friend.name for friend in friends}
    ratios: dict[str, list[float]] = defaultdict(list)
    for friend in friends:
        others = {peer.identity for peer in friend.session.peers.values()} | {friend.name}
        if others != names or friend.session.muted or friend.connection.closed is not None:
            raise BrokenPromiseError(f"{friend.name} sees {others}, muted {friend.session.muted}")
        for other in friends:
            least = dict(zip(("voice", "face"), LEAST[friend.line_bytes_per_s], strict=True))
            for kind, ratio in least.items() if other is not friend else ():
                came = friend.came[other.name, kind] / other.sent[kind]
                ratios[f"{friend.name} {kind}"].append(came)
                if came < ratio:
                    raise BrokenPromiseError(
                        f"{friend.name} got {came:.0%} of {other.name}'s {kind}s"
                    )
    if {peer.identity for peer in hub.membership.rooms["lobby"].peers} != names:
        raise BrokenPromiseError("a member is still in the room")
    if len(hub.membership.rooms) != 1 or hub.num_connections != len(friends):
        raise BrokenPromiseError(f"{hub.num_connections} connections, {hub.num_rooms} rooms")
