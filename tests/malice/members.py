"""Members of a call against its other members, on the relay without its sockets.

Three people talk in a room with keys: Ada, Ben, and Cho, whose line carries 160 kbit/s. One or two
others have tokens of their own, no manners, and a few tricks out of `TRICKS`, drawn for each run.
After every run this must hold for Ada, Ben and Cho:

    no starving         the others' voices and faces came, at least as many as `LEAST` says
    no muting           no stream was stopped, and no other member was closed
    no relabelling      a frame on Ada's stream is one that Ada sent; her name and identity are hers
    no outliving        a member that left is gone for the others, and sends nothing any more
"""

import random
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence

from fuzzing.damage import BOMBS
from fuzzing.targets import GOLDEN_BYTES
from helpers.members import FACE, VOICE, Member
from malice.people import BrokenPromiseError
from pica_protocol.client_session import ClientSession
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import SEQUENCE_MODULUS, Frame, encode_frame, media_message
from pica_protocol.messages import (
    BarIdentity,
    Join,
    Message,
    MutePeer,
    RemovePeer,
    Subscribe,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import Closed, State
from pica_server.config import RelayConfig
from pica_server.limits import RefusalError
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
MESSAGES = [each for each in (*GOLDEN_BYTES.values(), *BOMBS) if each]
"""What damaged messages are made of."""
CONFIG = RelayConfig(resume_grace_s=GRACE_S, room_capacity=8)


def admitted(join: Join) -> Admission:
    """Let in any peer that gives a name as the token."""
    if join.token in LINES_BYTES_PER_S or join.token.startswith("eve"):
        return Admission(identity=join.token, name=join.token.title())
    raise RefusalError("no token", CloseCode.UNAUTHORIZED)


class Friend(Member):
    """A member who behaves, and who notes what comes."""

    def __init__(self, hub: Hub, name: str, now: float) -> None:
        super().__init__(hub, name, tracks=(FACE, VOICE), now=now, address=name, token=name)
        self.name, self.line_bytes_per_s = name, LINES_BYTES_PER_S[name]
        self.sent: Counter[str] = Counter()
        self.came: Counter[tuple[str, str]] = Counter()
        self._line_bytes = 0.0
        self._under_way: OutboundMessage | None = None

    def listen(self, now: float) -> list[Message | Frame]:
        """Nothing comes but by the line: `read` takes it."""
        return []

    def publish(self, step: int, now: float) -> None:
        """Send a face at 25 frames a second, and as many packets of voice."""
        kind = ("face", "voice")[step % 2]
        self.sent[kind] += 1
        payload = f"{self.name} {kind} {step}".encode().ljust((24, 90)[step % 2])
        self.session.send_frame(payload, round(now * 1e6), track=step % 2)
        self.speak(now)

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
                self._note(event)
        self._line_bytes = min(self._line_bytes, self.line_bytes_per_s * STEP_S)

    def _note(self, event: object) -> None:
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


class Foe:
    """Somebody who has a token and tries what others do not, on one connection after another."""

    def __init__(self, hub: Hub, name: str, rng: random.Random) -> None:
        self.hub, self.name, self.rng = hub, name, rng
        self.tricks = rng.sample(TRICKS, rng.randint(1, 3))
        self.members: list[Member] = []
        self.is_away = True
        self.former: ClientSession | None = None
        self.heard: list[Frame] = []
        self.reads = rng.random() < 0.7

    @property
    def newest(self) -> Member:
        """The newest connection."""
        return self.members[-1]

    def act(self, now: float) -> None:
        """Come in, read perhaps, and try something."""
        if self.is_away or self.newest.session.closed is not None:
            if self.rng.random() < 0.06:
                self.join(now)
            return
        if self.reads:
            heard = self.newest.listen(now)
            self.heard += [each for each in heard if isinstance(each, Frame)]
            del self.heard[:-20]
        if self.newest.session.state is State.JOINED:
            self.rng.choice(self.tricks)(self, now)

    def join(
        self, now: float, token: str | None = None, former: ClientSession | None = None
    ) -> None:
        """Come in, perhaps under the name of another member."""
        member = Member(
            self.hub,
            self.rng.choice(("Ada", "Ben", "Eve")),
            room=self.rng.choice(("lobby",) * 5 + ("attic",)),
            tracks=self.rng.choice(((FACE, VOICE), (FACE,) * 4, (VOICE,) * 4, ())),
            now=now,
            address=self.name,
            token=self.name if token is None else token,
            resumable=self.rng.random() < 0.8,
            former=former,
        )
        self.members.append(member)
        self.is_away = False
        if member.session.is_resumable:
            self.former = member.session

    def say(self, data: bytes, now: float) -> None:
        """Send a message on the newest connection, as it is."""
        self.hub.receive(self.newest.connection, [data], now)

    def tell(self, message: Message, now: float) -> None:
        """Send a control message."""
        self.say(encode_message(message), now)

    def victim(self) -> str:
        """The peer id of a member, or one that is often dealt."""
        return self.rng.choice([*self.newest.session.peers, "p1", "p2", "p3"])

    def show(self, streams: Sequence[int], payload: bytes, now: float) -> None:
        """Send a frame on each of some streams, also those of others, in one message."""
        frames = []
        for stream in streams:
            is_now = self.rng.random() < 0.5
            frame = Frame(
                stream=stream,
                sequence=self.rng.randrange(SEQUENCE_MODULUS),
                captured_us=round(now * 1e6) if is_now else self.rng.randrange(2**40),
                payload=payload,
            )
            frames.append(encode_frame(frame))
        self.say(media_message(frames), now)


def flood(foe: Foe, now: float) -> None:
    """Send as much as the relay lets through, on every track."""
    size = foe.rng.choice((1, 24, 90, 300, 1180))
    for track in foe.newest.session.tracks:
        for _ in range(foe.rng.choice((1, 2, 8, 40))):
            foe.show([track.stream], b"eve" + bytes(size), now)


def send_on_other_streams(foe: Foe, now: float) -> None:
    """Send on a stream of another member, or of none; alone or behind an own frame."""
    own = [track.stream for track in foe.newest.session.tracks]
    streams = [*own, 1, 2, 3, 4, foe.rng.randrange(1, 65_536)]
    foe.show(foe.rng.sample(streams, 2), b"eve", now)


def replay(foe: Foe, now: float) -> None:
    """Send a frame of another member once more."""
    if foe.heard and (tracks := foe.newest.session.tracks):
        frame = foe.rng.choice(foe.heard)
        stream = foe.rng.choice((frame.stream, tracks[0].stream))
        payload = b"eve" + frame.payload[:1000] if stream != frame.stream else frame.payload
        foe.show([stream], payload, now)


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
    """Lose the connection and come back, to one's place, an old one or none."""
    foe.newest.lose_connection(now)
    foe.is_away = True
    if foe.rng.random() < 0.7:
        foe.join(now, former=foe.former)


def join_beside(foe: Foe, now: float) -> None:
    """Join once more beside oneself, now and then without a token."""
    foe.join(now, foe.rng.choice((foe.name, foe.name, "", "mallory")), foe.former)


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
    foe.hub.is_sending(foe.newest.connection, now)


def do_nothing(foe: Foe, now: float) -> None:
    """Wait."""


TRICKS: tuple[Callable[[Foe, float], None], ...] = (
    *(flood, flood, send_on_other_streams, replay, whisper, subscribe, change_metadata, moderate),
    *(lose_connection, join_beside, send_damaged, join_again, stop_reading, do_nothing),
)


def run(seed: int) -> Counter[str]:
    """Hold one call; count what was tried, by trick, and with which codes the foes were closed.
    BrokenPromiseError says the seed."""
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
                counts += _leave(foes, now)
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


def _leave(foes: list[Foe], now: float) -> Counter[str]:
    codes: Counter[str] = Counter()
    for member in [member for foe in foes for member in foe.members]:
        member.lose_connection(now)
        codes[f"closed {member.closed_code}"] += 1
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
    if {each.peer.identity for each in hub.membership.rooms["lobby"].members.values()} != names:
        raise BrokenPromiseError("a member is still in the room")
    if hub.num_rooms != 1 or hub.num_connections != len(friends):
        raise BrokenPromiseError(f"{hub.num_connections} connections, {hub.num_rooms} rooms")
