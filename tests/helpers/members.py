"""Members of rooms without any socket: the bytes between session and hub are carried by hand."""

from collections.abc import Callable

from pica_protocol.client_session import ClientSession
from pica_protocol.codec import decode_message
from pica_protocol.frames import Frame, decode_media
from pica_protocol.messages import Message, Metadata, Track
from pica_server.config import RelayConfig
from pica_server.room.hub import Hub
from pica_server.room.room import Connection

FACE = Track(kind="face")
VOICE = Track(kind="voice", deadline_ms=200)


class Member:
    """A client session and its connection."""

    def __init__(
        self,
        hub: Hub,
        name: str,
        *,
        room: str = "lobby",
        tracks: tuple[Track, ...] = (FACE,),
        now: float = 0.0,
        address: str = "",
        token: str = "",
        metadata: Metadata = (),
        resumable: bool = False,
        former: ClientSession | None = None,
    ) -> None:
        self.hub = hub
        self.connection: Connection = hub.connect(now, address)
        self.session = ClientSession(
            room=room,
            name=name,
            tracks=tracks,
            now=now,
            token=token,
            metadata=metadata,
            resumable=resumable,
            former=former,
        )
        self.speak(now)
        self.heard = self.listen(now)

    @property
    def peer_id(self) -> str:
        return self.session.peer_id

    @property
    def stream(self) -> int:
        return self.session.tracks[0].stream

    @property
    def closed_code(self) -> int | None:
        return None if self.connection.closed is None else self.connection.closed.code

    def speak(self, now: float) -> None:
        self.hub.receive(self.connection, self.session.messages_to_send(now), now)

    def send_frame(self, payload: bytes, now: float, *, track: int = 0) -> None:
        self.session.send_frame(payload, captured_us=0, track=track)
        self.speak(now)

    def listen(self, now: float) -> list[Message | Frame]:
        heard: list[Message | Frame] = []
        while (message := self.hub.take(self.connection, now)) is not None:
            self.hub.sent(self.connection, message, now)
            self.session.receive_data(message.data, now)
            if message.num_frames:
                heard += decode_media(message.data)
            else:
                heard.append(decode_message(message.data))
        return heard

    def lose_connection(self, now: float) -> ClientSession:
        """Die without a word; returns what there is to come back with."""
        self.hub.disconnect(self.connection, 1006, "", now)
        return self.session


def hub_with(
    *names: str, config: RelayConfig | None = None, resumable: bool = False
) -> tuple[Hub, list[Member]]:
    """A hub with secrets that count up, and members of one room who have heard all there is."""
    hub = Hub(config or RelayConfig(), new_secret=counting_secrets())
    members = [Member(hub, name, resumable=resumable) for name in names]
    for member in members:
        member.listen(now=0.0)
    hub.take_ready()
    return hub, members


def counting_secrets() -> Callable[[], str]:
    """Return a source of different secrets that everybody can guess."""
    numbers = iter(range(1_000_000))
    return lambda: f"secret{next(numbers)}"
