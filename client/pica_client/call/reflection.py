"""Our own face as the others get it: a call of one, fed with what is sent. Pure.

The frames that leave are decoded and played out as a receiver does it. So what the codec takes
away, and a face that is off, is seen here as it is seen there; what the network does to
it is not.
"""

from dataclasses import replace
from typing import Final

from pica_client.call.call import Call
from pica_client.call.roster import SELF_ID
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import EncodedFrame
from pica_protocol.frames import SEQUENCE_MODULUS, Frame
from pica_protocol.messages import Joined, Peer, Track

_STREAM: Final = 1


class Reflection:
    """Looks at what one sender sends.

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

    def has(self, identity: str) -> bool:
        return identity == self._identity

    def get(self, identity: str) -> Avatar | None:
        return self._avatar if self.has(identity) else None

    def note(self, identity: str) -> str:
        return ""
