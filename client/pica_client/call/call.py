"""The receiving half of a call: its members, their streams, and their faces at display time.

Events of the link go in on the network thread, faces come out on the drawing thread, one lock
between them. No socket and no clock: `endpoint.Receiver` is the shell around it.

What is wrong with one stream stays with that stream: a payload that cannot be read is counted and
the face is held; a peer whose avatar is missing gets a seat without a face.
"""

import threading
from collections import deque
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from pica_client.avatars.library import AvatarStore
from pica_client.call.participant import Participant, Tell
from pica_client.call.roster import SECRET_NEEDED, SELF_ID, Roster, name_warnings
from pica_client.call.status import CallStatus, FaceState, FaceStatus
from pica_client.e2ee.secret import SealState
from pica_client.stats import MAX_SAMPLES
from pica_client.tracks import FACE_TRACK, voice_of
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import EncodedFrame, LatentSample
from pica_core.errors import AvatarFileError, LatentError
from pica_protocol import messages
from pica_protocol.frames import SEQUENCE_MODULUS, Frame
from pica_protocol.messages import Joined, Peer, Track
from pica_protocol.session import ClientEvent

if TYPE_CHECKING:  # a call without a secret needs no cryptography
    from pica_client.e2ee.guard import Guard


class ArrivedFace(NamedTuple):
    """A face as it came, before any playout."""

    peer_id: str
    name: str
    avatar_id: str
    sample: LatentSample
    captured_us: int
    """Sender's clock."""
    arrived_s: float


class Ears(Protocol):
    """Where the voices of a call go. Called on the network's thread."""

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        """Take a packet of a voice, see `voice.opus`; they come in the order of arrival."""
        return

    def seat(self, peer_ids: Sequence[str]) -> None:
        """Take the other members with a face or a voice, in the order of coming."""
        return

    def heard_us(self, peer_id: str, now: float) -> int | None:
        """The moment of a peer's voice, on its clock, that leaves the loudspeaker now; None: there
        is none. Any thread may ask."""
        return None


class Call:
    """The members of a room and how their faces look.

    Attributes:
        guard: How the encryption stands is asked of it; None where nothing is encrypted.
        ears: Take the voices; None: none are wanted.
        errors: Payloads that could not be read.
        skews_s: By how much each face is off its voice when it is seen, either way.
        delays_s: How old the sound was that was heard when a face was shown; only where sender and
            receiver share a clock does it say anything.
    """

    def __init__(
        self,
        avatars: AvatarStore,
        *,
        ears: Ears | None = None,
        on_face: Callable[[ArrivedFace], None] | None = None,
    ) -> None:
        """Prepare.

        Args:
            ears: Take the voices, by which faces are led.
            on_face: Takes every face that can be read, in the order of arrival, on the network's
                thread.
        """
        self.errors = 0
        self._avatars = avatars
        self._on_face = on_face
        self._lock = threading.Lock()
        self._roster = Roster()
        self._seats: dict[str, Participant] = {}  # bounded by the protocol's limit on peers
        self._by_stream: dict[int, Participant] = {}
        self._window_begin_s: float | None = None
        self.ears = ears
        self._voices: dict[int, str] = {}  # peer ids by stream
        self.guard: Guard | None = None
        self.skews_s: deque[float] = deque(maxlen=MAX_SAMPLES)
        self.delays_s: deque[float] = deque(maxlen=MAX_SAMPLES)

    # The network's side

    def receive_event(self, event: ClientEvent, now: float) -> None:
        """Take an event of the link's session."""
        if isinstance(event, Frame):
            if (speaker := self._voices.get(event.stream)) is not None:
                if self.ears is not None:
                    self.ears.receive(speaker, event, now)
                return
            with self._lock:
                face = self._receive_frame(event, now)
            if face is not None and self._on_face is not None:
                self._on_face(face)
            return
        with self._lock:
            self._roster.receive_event(event, now)
            match event:
                case messages.Joined(peers=peers):
                    present = {peer.peer_id: peer for peer in peers}
                    for peer_id, seat in list(self._seats.items()):
                        if seat.stays(present.get(peer_id)):
                            seat.join_again(now)
                        else:
                            self._remove(peer_id)
                    for peer in peers:
                        self._add(peer)
                case messages.PeerJoined(peer=peer):
                    self._add(peer)
                case messages.PeerLeft(peer_id=peer_id):
                    self._remove(peer_id)
                case _:
                    pass  # a closed session is the link's affair
            for peer_id, seat in self._seats.items():
                seat.member = self._roster.member(peer_id)
            members = self._roster.members
        voices = ((voice_of(member.peer), member.peer.peer_id) for member in members)
        self._voices = {track.stream: peer_id for track, peer_id in voices if track is not None}
        if self.ears is not None:
            self.ears.seat([m.peer_id for m in members if m.has_voice or not m.is_watching])

    def tell_subscriptions(self, tell: Tell, now: float) -> None:
        """Tell the relay how much is wanted, where that is due; some 50 times a second."""
        with self._lock:
            for seat in self._seats.values():
                seat.tell_subscription(tell, now)

    # The display's side

    def subscribe(self, peer_id: str, every: int, now: float) -> None:
        """Note how much of a peer's stream is worth having, as often as every drawn frame.

        Args:
            peer_id: Whose; a peer that has left is no error.
            every: 1 for every frame, 2 or 4 for each second or fourth one, 0 for nothing at all.
        """
        with self._lock:
            seat = self._seats.get(peer_id)
            if seat is not None:
                seat.subscribe(every, now)

    def faces(
        self, now: float, ahead_s: float = 0.0, resting: Container[str] = ()
    ) -> list[FaceState]:
        """Return everybody who should have a seat at local time `now`, seconds, by rising place.

        ``ahead_s`` is in how many seconds these faces will be seen: lips go with the sound that is
        heard then. Peers whose ids are in `resting` keep the face that they show.
        """
        with self._lock:
            faces = [self._face(seat, now, ahead_s, resting) for seat in self._seats.values()]
            return sorted(faces, key=lambda face: face.place)

    def avatar(self, avatar_id: str) -> Avatar | None:
        """Return the avatar with this id; None while it is still on its way.

        Raises:
            AvatarFileError: It is not to be had here, or came and must not be used: says the fix.
        """
        return self._avatars.get(avatar_id)

    # The people

    @property
    def own_name(self) -> str:
        """What the others are shown as our name; other members of that name get a number."""
        return self._roster.own_name

    @own_name.setter
    def own_name(self, name: str) -> None:
        self._roster.own_name = name

    def room(self, now: float, *, is_busy: bool = False) -> CallStatus:
        """Return the other members of the room, watchers included, what happened since the last
        call, and how long we have been here; asked about twice a second.

        Args:
            is_busy: Whether this machine was too busy, since the last call, to say how frames come.
        """
        with self._lock:
            self._roster.handle_timer(now)
            joined_s, own_name, seals = self._roster.joined_s, self._roster.own_name, self._seals()
            members = self._roster.members
            warnings = name_warnings((member.peer for member in members), own_name)
            shown = []
            for member in members:
                seal, note = seals.get(member.peer_id), ""
                if seat := self._seats.get(member.peer_id):
                    member, note = seat.rated(now, is_busy=is_busy), self._note(seat, now)
                elif seal is not None:  # watchers have no face that could be missing
                    note = seal.note
                shown.append(
                    replace(
                        member,
                        is_verified=seal is SealState.VERIFIED,
                        warning=warnings[member.peer_id],
                        note="connection lost" if member.is_away else note,
                    )
                )
            return CallStatus(
                participants=tuple(shown),
                news=tuple(self._roster.take_news()),
                duration_s=0.0 if joined_s is None else now - joined_s,
            )

    # Statistics

    @property
    def num_live(self) -> int:
        """Peers of whom a frame has been read."""
        with self._lock:
            return sum(seat.last_arrival_s is not None for seat in self._seats.values())

    def begin_window(self, now: float) -> None:
        """Let the statistics begin here: what came before was warming up."""
        with self._lock:
            self._window_begin_s = now
            self.skews_s.clear()
            self.delays_s.clear()
            for seat in self._seats.values():
                seat.begin_window()

    def stats(self, now: float) -> dict[str, Any]:
        """How the stream of each peer came in since `begin_window`, or since it came."""
        with self._lock:
            begin_s = self._window_begin_s
            seconds = None if begin_s is None else now - begin_s
            peers = [seat.stats(seconds) for seat in self._seats.values()]
            return {
                "seconds": None if seconds is None else round(seconds, 3),
                "peers": peers,
                "concealed": sum(peer["concealed"] for peer in peers),
                "errors": self.errors,
            }

    def _add(self, peer: messages.Peer) -> None:
        if peer.peer_id in self._seats:
            return
        for track in peer.tracks:
            if track.kind == FACE_TRACK:
                # It is loaded by the time the first frame comes. What is wrong with it is the
                # viewer's news, and no reason to lose the connection.
                with suppress(AvatarFileError):
                    self._avatars.get(track.avatar)
                member = self._roster.member(peer.peer_id)
                seat = Participant(member, track)
                self._seats[peer.peer_id] = self._by_stream[track.stream] = seat
                return  # one face a person

    def _remove(self, peer_id: str) -> None:
        seat = self._seats.pop(peer_id, None)
        if seat is not None:
            self._by_stream.pop(seat.track.stream, None)

    def _receive_frame(self, frame: Frame, now: float) -> ArrivedFace | None:
        seat = self._by_stream.get(frame.stream)
        if seat is None:
            return None  # as when its peer has just left
        if self._lacks_secret(seat):
            return None  # it could be read as a latent, and would be a heap of triangles
        try:
            sample = seat.receive_frame(frame, now, self._avatars)
        except LatentError:
            self.errors += 1
            return None
        if sample is None:
            return None
        peer = seat.member.peer
        who = peer.peer_id, peer.name, seat.track.avatar
        return ArrivedFace(*who, sample, frame.captured_us, now)

    def _lacks_secret(self, seat: Participant) -> bool:
        """Whether a peer's payloads are encrypted, as it has told us, and we have no secret."""
        return seat.member.has_whispered and self.guard is None

    def _seals(self) -> Mapping[str, SealState]:
        """How the encryption of each peer stands, by peer id; empty where we do not encrypt."""
        return {} if self.guard is None else self.guard.status.peers

    def _note(self, seat: Participant, now: float) -> str:
        """Why a face is not to be seen, or not as it should be; empty when nothing is wrong."""
        peer_id = seat.member.peer.peer_id
        note = self._seals().get(peer_id, SealState.WAITING).note or seat.note
        if note:
            return note
        if self._lacks_secret(seat):
            return SECRET_NEEDED
        if seat.played is None:
            return self._avatars.note(seat.track.avatar) or "no face yet"
        return "no signal" if seat.is_stale(now) else ""

    def _face(
        self, seat: Participant, now: float, ahead_s: float, resting: Container[str]
    ) -> FaceState:
        member, peer = seat.member, seat.member.peer
        is_resting = seat.played is not None and peer.peer_id in resting
        voice_us = None if self.ears is None else self.ears.heard_us(peer.peer_id, now)
        heard_us = None if voice_us is None else voice_us + round(ahead_s * 1e6)
        played, is_held = (seat.played, False) if is_resting else seat.play(now, heard_us)
        face = FaceState(
            peer_id=peer.peer_id,
            name=member.name,
            avatar_id=seat.track.avatar,
            latent=None,
            status="waiting",
            note=self._note(seat, now),
            place=member.place,
        )
        if played is None or self._lacks_secret(seat):
            return face
        status: FaceStatus = "concealed" if is_held or played.is_concealed else "live"
        if seat.says_absent:
            status = "away"
        elif seat.is_stale(now):
            status = "stale"
        if heard_us is not None and not (is_held or is_resting):
            self.skews_s.append(abs(played.captured_us - heard_us) / 1e6)
            self.delays_s.append(now + ahead_s - heard_us / 1e6)
        return replace(
            face,
            latent=played.sample.latent,
            rotation=played.sample.rotation,
            translation_m=played.sample.translation_m,
            captured_us=max(played.captured_us, 0),
            status=status,
        )


_STREAM: Final = 1


class Reflection:
    """Our own face as the others get it: a call of one, fed with what is sent.

    The frames that leave are decoded and played out as a receiver does it. So what the codec takes
    away, and a face that is off, is seen here as it is seen there; what the network does to it is
    not.

    Attributes:
        call: Shows it.
    """

    def __init__(self, avatar: Avatar, track: Track) -> None:
        """Begin before the first frame."""
        self.call = Call(_OneAvatar(track.avatar, avatar))
        self._num_frames = 0
        peer = Peer(peer_id=SELF_ID, name="You", tracks=(replace(track, stream=_STREAM),))
        self.call.receive_event(Joined(room="mirror", peer_id="others", peers=(peer,)), now=0.0)

    def receive(self, coded: EncodedFrame, captured_us: int, now: float) -> None:
        """Take a frame that was sent at `now`, seconds."""
        frame = Frame(
            stream=_STREAM,
            sequence=self._num_frames % SEQUENCE_MODULUS,
            captured_us=captured_us,
            payload=coded.payload,
        )
        self._num_frames += 1
        self.call.receive_event(frame, now)


class _OneAvatar:
    def __init__(self, identity: str, avatar: Avatar) -> None:
        self._identity, self._avatar = identity, avatar

    def get(self, identity: str) -> Avatar | None:
        return self._avatar if identity == self._identity else None

    def note(self, identity: str) -> str:
        return ""
