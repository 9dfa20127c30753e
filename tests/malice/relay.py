"""A relay that forges, replays, reorders, withholds and relabels at random, and people who use it.

Sessions, guards and calls are the real ones; the relay is a model that speaks the real bytes; time
is a number. A run is a seed: `run(seed)` is the same each time, and raises `BrokenPromiseError`
with the seed when one of these does not hold:

- nobody is shown a frame twice, not even on two connections;
- nobody is shown a frame under another name or avatar, or one of their own;
- nobody is shown a frame that was sealed before they heard that its sender had left or come back;
- nobody counts as a member who had gone before they were heard of;
- who has left opens no frame of anybody who has heard of it, unless it is in their code;
- once the relay behaves, everybody is verified and shown to everybody, and all have one code.

What is not modelled: clocks that drift, sockets, and a relay that knows the room secret.
"""

import random
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import replace

from malice.people import (
    AVATARS,
    FACE,
    NAMES,
    ROOM,
    SECRET,
    BrokenPromiseError,
    Leaver,
    Line,
    Person,
)
from pica_client.e2ee.guard import Guard
from pica_protocol.client_session import ClientSession
from pica_protocol.codec import decode_message, encode_message
from pica_protocol.frames import MEDIA_KIND, Frame, decode_media, encode_frame, media_message
from pica_protocol.messages import (
    Join,
    Joined,
    Message,
    Peer,
    PeerAway,
    PeerJoined,
    PeerLeft,
    Track,
    Whisper,
)
from pica_protocol.session import ClientEvent

MAX_HISTORY = 400
"""Messages that the relay remembers to say again."""
GOOD_S = 12.0
"""What everybody gets to find each other, once the relay behaves."""


class World:
    """People, the relay between them, the clock, and what must not happen."""

    def __init__(self, seed: int, num_people: int) -> None:
        self.seed = seed
        self.chance = random.Random(f"relay/{seed}")
        self.now = 100.0
        self.people = [Person(index, str(seed)) for index in range(num_people)]
        self.lines: list[Line] = []
        self.history: list[tuple[Line, bytes]] = []
        self.peers_told: list[Peer] = []
        self.leavers: list[Leaver] = []
        self.sealed: dict[str, list[int]] = defaultdict(list)
        """Capture times of what was sealed under each peer id."""
        self.dead: dict[int, set[int]] = defaultdict(set)
        self.opened: dict[int, set[int]] = defaultdict(set)
        self.shown: dict[int, set[int]] = defaultdict(set)
        self.malice = 0.0
        self.counts: Counter[str] = Counter()
        self._serial = 0
        self._stream = 0

    def break_promise(self, what: str) -> None:
        """Stop here."""
        raise BrokenPromiseError(f"seed {self.seed}: {what}")

    # People

    def connect(self, person: Person) -> None:
        """Dial, as a link does."""
        person.line = Line(person)
        self.lines.append(person.line)
        person.guard.begin(ROOM, person.name)
        person.session = ClientSession(
            room=ROOM,
            name=person.name,
            tracks=(Track(kind="face", avatar=AVATARS[person.index]),),
            now=self.now,
            timeout_s=60.0,
            seal=person.guard.seal,
        )
        self.pump(person)

    def hang_up(self, person: Person) -> None:
        """The connection is gone; the relay does not have to say so to anybody."""
        session, line = person.session, person.line
        if session is not None:
            self.take(person, session.receive_close(1006, "", self.now))
        person.session = person.line = None
        if line is not None and line in self.lines:
            self.lines.remove(line)
            if line.peer is not None and not self.lies(0.3):
                self.tell_others(line, PeerLeft(peer_id=line.peer.peer_id, reason="lost"))

    def leave(self, person: Person) -> None:
        """Go for good, and keep what one has: another guard comes back later."""
        line = person.line
        if line is None or line.peer is None or person.session is None:
            return
        status = person.guard.status
        if status.members:
            key = status.members[0][0]
            self.leavers.append(Leaver(line.peer.peer_id, person.guard, key))
        person.guard = Guard(SECRET, random_bytes=person.randomness.randbytes)
        person.session.close()
        self.pump(person)
        self.hang_up(person)

    def send(self, person: Person) -> None:
        """Send one face."""
        session, line = person.session, person.line
        if session is None or line is None or line.peer is None or not person.is_joined:
            return
        step = round(self.now * 1e3) * 1000 + person.index * 100
        person.captured_us = max(person.captured_us + 1000, step)
        session.send_frame(FACE, person.captured_us)
        self.sealed[line.peer.peer_id].append(person.captured_us)
        self.pump(person)

    def pump(self, person: Person) -> None:
        """Hand the relay what a client has to say, as the writer of a link does."""
        session, line = person.session, person.line
        if session is None or line is None:
            return
        if person.is_joined:
            for peer_id, data in person.guard.messages_to_send(self.now):
                session.tell(Whisper(peer_id=peer_id, data=data))
        for data in session.messages_to_send(self.now):
            self.hear(line, data)

    def deliver(self, line: Line) -> None:
        """Let a client read what waits for it."""
        person = line.person
        while line.waiting and line.held_until_s <= self.now and person.line is line:
            session = person.session
            if session is None:
                return
            self.take(person, session.receive_data(line.waiting.pop(0), self.now))
            if session.closed is not None:  # the relay broke the protocol: come back later
                self.counts["refused"] += 1
                self.hang_up(person)

    def take(self, person: Person, events: list[ClientEvent]) -> None:
        """Do what a link and a receiver do with events, and look at what comes out."""
        for event in events:
            self.note(person, event)
            for passed in person.guard.receive_event(event, self.now):
                if isinstance(passed, Frame):
                    self.look_at_opened(person, passed)
                person.call.receive_event(passed, self.now)
            for peer_id in person.guard.status.verified & person.never_members:
                self.break_promise(f"{person.name} counts {peer_id}, who had gone before")
        while person.seen:
            face = person.seen.pop(0)
            owner = face.captured_us // 100 % 10
            if (face.name, face.avatar_id) != (NAMES[owner], AVATARS[owner]):
                self.break_promise(f"{person.name} sees {NAMES[owner]} as {face.name}")
            if face.captured_us in self.shown[person.index]:
                self.break_promise(f"{person.name} sees a frame of {face.name} twice")
            self.shown[person.index].add(face.captured_us)
            self.counts["shown"] += 1

    def note(self, person: Person, event: ClientEvent) -> None:
        """Keep what was told to whom, for the promises."""
        match event:
            case Joined(peers=peers):
                person.parted.clear()
                person.never_members.clear()
                news = [peer.peer_id for peer in peers]
            case PeerJoined(peer=peer):
                news = [peer.peer_id]
            case PeerAway(peer_id=peer_id, is_away=False) | PeerLeft(peer_id=peer_id):
                self.dead[person.index].update(self.sealed[peer_id])
                person.parted.add(peer_id)
                news = [peer_id]
            case _:
                return
        present = {line.peer.peer_id for line in self.lines if line.peer is not None}
        person.never_members.update(peer_id for peer_id in news if peer_id not in present)

    def look_at_opened(self, person: Person, frame: Frame) -> None:
        """Check a frame that a guard let through."""
        captured_us = frame.captured_us
        name = NAMES[captured_us // 100 % 10]
        if captured_us // 100 % 10 == person.index:
            self.break_promise(f"{name} gets a frame of their own")
        if captured_us in self.opened[person.index]:
            self.break_promise(f"{person.name} opens a frame of {name} twice")
        if captured_us in self.dead[person.index]:
            self.break_promise(f"{person.name} opens a frame of {name} from before a leave")
        self.opened[person.index].add(captured_us)
        self.counts["opened"] += 1

    # The relay

    def lies(self, probability: float = 1.0) -> bool:
        """Whether it misbehaves, this time."""
        return self.chance.random() < self.malice * probability

    def hear(self, line: Line, data: bytes) -> None:
        """Take one message of a client."""
        self.history.append((line, data))
        del self.history[:-MAX_HISTORY]
        if data[0] == MEDIA_KIND:
            self.ask_leavers(line, data)
            for other in self.lines:
                if other is not line and other.peer is not None:
                    other.waiting.append(data)
            return
        match decode_message(data):
            case Join() as join:
                self.admit(line, join)
            case Whisper(peer_id=peer_id, data=note) if line.peer is not None:
                told = encode_message(Whisper(peer_id=line.peer.peer_id, data=note))
                for other in self.lines:
                    if other.peer is not None and other.peer.peer_id == peer_id:
                        other.waiting.append(told)

    def admit(self, line: Line, join: Join) -> None:
        """Answer a join, and tell the others."""
        self._serial += 1
        self._stream += 1
        peer_id = f"p{self._serial}"
        if self.lies(0.1) and self.peers_told:
            peer_id = self.chance.choice(self.peers_told).peer_id
        tracks = (replace(join.tracks[0], stream=self._stream),)
        others = [other.peer for other in self.lines if other.peer is not None]
        line.peer = Peer(peer_id=peer_id, name=join.name, tracks=tracks)
        self.peers_told.append(line.peer)
        for person in self.people:  # an id that is given out again
            person.never_members.discard(peer_id)
        joined = Joined(room=join.room, peer_id=peer_id, tracks=tracks, peers=tuple(others))
        if self.lies(0.5):
            joined = self.lie_about(joined)
        line.waiting.append(encode_message(joined))
        self.tell_others(line, PeerJoined(peer=line.peer))

    def lie_about(self, joined: Joined) -> Joined:
        """Answer a join with something else."""
        peers = [self.relabelled(p) if self.chance.random() < 0.5 else p for p in joined.peers]
        match self.chance.randrange(5):
            case 0:
                return replace(joined, room="s")
            case 1:
                own = Peer(peer_id=joined.peer_id, name="Mirror", tracks=joined.tracks)
                return replace(joined, peers=(*joined.peers, own))
            case 2:
                gone = self.chance.choice(self.peers_told)
                return replace(joined, peers=(*joined.peers, gone))
            case 3 if len(peers) > 1:
                names = [peer.name for peer in peers]
                self.chance.shuffle(names)
                swapped = [replace(p, name=n) for p, n in zip(peers, names, strict=True)]
                return replace(joined, peers=tuple(swapped))
        return replace(joined, peers=tuple(peers))

    def relabelled(self, peer: Peer) -> Peer:
        """Describe somebody with something of somebody else."""
        other = self.chance.choice(self.peers_told)
        match self.chance.randrange(4):
            case 0:
                return replace(peer, name=other.name)
            case 1:
                return replace(peer, tracks=other.tracks)
            case 2:
                return replace(peer, peer_id=other.peer_id)
        track = replace(peer.tracks[0], avatar=other.tracks[0].avatar)
        return replace(peer, tracks=(track,))

    def tell_others(self, line: Line, message: Message) -> None:
        """Say something to everybody else in the room."""
        for other in self.lines:
            if other is not line and other.peer is not None and not self.lies(0.2):
                other.waiting.append(encode_message(message))

    def ask_leavers(self, line: Line, data: bytes) -> None:
        """Let those who left try to open what goes by."""
        person = line.person
        members = {key for key, _ in person.guard.status.members}
        for leaver in self.leavers[-3:]:
            if leaver.peer_id not in person.parted or leaver.public_key in members:
                continue
            for frame in decode_media(data):
                self.counts["tried by leavers"] += 1
                if leaver.guard.receive_event(frame, self.now):
                    self.break_promise(f"{leaver.peer_id} left and reads {person.name}")

    def misbehave(self) -> None:
        """Do one thing that no honest relay does."""
        if not self.lines:
            return
        line = self.chance.choice(self.lines)
        trick = self.chance.choice(TRICKS)
        self.counts[trick.__name__] += 1
        trick(self, line)

    def replay_media(self, line: Line) -> None:
        """Send old frames again, as they were or on another stream."""
        old = [data for _, data in self.history if data[0] == MEDIA_KIND]
        for data in self.chance.sample(old, min(4, len(old))):
            frames = list(decode_media(data))
            if self.chance.random() < 0.3:
                stream = self.chance.randint(1, self._stream)
                frames = [replace(frame, stream=stream) for frame in frames]
            line.waiting.append(media_message([encode_frame(frame) for frame in frames]))

    def replay_notes(self, line: Line) -> None:
        """Say old notes again: to their receiver, or to anybody; from their sender, or anybody."""
        own = None if line.peer is None else line.peer.peer_id
        for sender, data in self.chance.sample(self.history, min(60, len(self.history))):
            if data[0] == MEDIA_KIND or sender.peer is None:
                continue
            message = decode_message(data)
            if not isinstance(message, Whisper):
                continue
            if message.peer_id == own or self.chance.random() < 0.1:
                sender_id = sender.peer.peer_id
                if self.chance.random() < 0.1:
                    sender_id = self.chance.choice(self.peers_told).peer_id
                line.waiting.append(encode_message(Whisper(peer_id=sender_id, data=message.data)))

    def forge_return(self, line: Line) -> None:
        """Say that somebody left and came, or came back; or only half of it; or otherwise."""
        peer = self.chance.choice(self.peers_told)
        if self.chance.random() < 0.4:
            peer = self.relabelled(peer)
        gone, back = PeerLeft(peer_id=peer.peer_id), PeerAway(peer_id=peer.peer_id, is_away=False)
        came, away = PeerJoined(peer=peer), PeerAway(peer_id=peer.peer_id, is_away=True)
        told: tuple[Message, ...] = self.chance.choice(
            ((gone, came), (back,), (away, back), (gone,), (came,), (gone, came))
        )
        line.waiting += [encode_message(message) for message in told]

    def return_and_replay(self, line: Line) -> None:
        """Make a guard forget, and then tell it all again."""
        self.forge_return(line)
        self.replay_notes(line)
        self.replay_media(line)

    def reflect(self, line: Line) -> None:
        """Show somebody to themselves."""
        if line.peer is None:
            return
        mirror = replace(line.peer, peer_id=f"{line.peer.peer_id}m", name="Mirror")
        told = line.peer if self.chance.random() < 0.5 else mirror
        line.waiting.append(encode_message(PeerJoined(peer=told)))
        for sender, data in self.history[-40:]:
            if sender is line and data[0] == MEDIA_KIND:
                line.waiting.append(data)
            elif sender is line and isinstance(message := decode_message(data), Whisper):
                whisper = Whisper(peer_id=told.peer_id, data=message.data)
                line.waiting.append(encode_message(whisper))

    def withhold(self, line: Line) -> None:
        """Let somebody wait."""
        line.held_until_s = self.now + self.chance.uniform(0.1, 4.0)

    def lose(self, line: Line) -> None:
        """Lose something that waits."""
        if line.waiting:
            line.waiting.pop(self.chance.randrange(len(line.waiting)))

    def reorder(self, line: Line) -> None:
        """Mix what waits."""
        self.chance.shuffle(line.waiting)

    def cut(self, line: Line) -> None:
        """End a connection."""
        self.hang_up(line.person)

    # A run

    def step(self) -> None:
        """Let a moment pass."""
        self.now += self.chance.choice((0.01, 0.03, 0.05, 0.3, 1.2))
        for person in self.people:
            if person.session is None and self.chance.random() < 0.5:
                self.connect(person)
            if self.chance.random() < 0.7:
                self.send(person)
            if self.chance.random() < 0.03:
                self.leave(person)
            elif self.chance.random() < 0.03:
                self.hang_up(person)
            self.pump(person)
        if self.lies():
            self.misbehave()
        for line in list(self.lines):
            self.deliver(line)

    def behave(self) -> None:
        """Show that all is well once the relay is honest: on new connections, if it was not."""
        was_honest = self.malice == 0
        self.malice = 0.0
        for line in self.lines:
            line.held_until_s = 0.0
        for person in self.people:
            if not was_honest:
                self.hang_up(person)
            if person.session is None:
                self.connect(person)
        end_s = self.now + GOOD_S
        before: dict[int, set[int]] = {}
        while self.now < end_s:
            self.now += 0.1
            if not before and self.now > end_s - 2:
                before = {person.index: set(self.opened[person.index]) for person in self.people}
            for person in self.people:
                if before:
                    self.send(person)
                self.pump(person)
            for line in list(self.lines):
                self.deliver(line)
        coded = {tuple(sorted(person.guard.status.members)) for person in self.people}
        if len(coded) != 1 or not self.people[0].guard.status.code:
            self.break_promise(f"an honest relay, and {len(coded)} codes")
        for person in self.people:
            frames = self.opened[person.index] - before[person.index]
            owners = Counter(captured_us // 100 % 10 for captured_us in frames)
            if len(owners) != len(self.people) - 1 or min(owners.values()) < 19:
                self.break_promise(f"an honest relay, and {person.name} opens {dict(owners)}")
            if len(person.guard.status.verified) != len(self.people) - 1:
                self.break_promise(f"an honest relay, and {person.guard.status.peers}")


TRICKS: tuple[Callable[[World, Line], None], ...] = (
    *(World.replay_media, World.replay_notes, World.forge_return),
    *(World.return_and_replay, World.return_and_replay, World.reflect),
    *(World.withhold, World.lose, World.reorder, World.cut),
)


def run(seed: int) -> Counter[str]:
    """Let two to four people meet on a relay, and count what happened."""
    chance = random.Random(f"run/{seed}")
    world = World(seed, num_people=chance.choice((2, 3, 3, 4)))
    world.malice = chance.choice((0.0, 0.2, 0.5, 0.9))
    for person in world.people:
        world.connect(person)
    for _ in range(40):
        world.step()
    world.behave()
    return world.counts
