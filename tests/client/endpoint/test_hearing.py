"""Who is heard, and from where, as people come and go."""

from collections.abc import Mapping

import pytest

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.endpoint import WIDTH_RAD, Hearing
from pica_client.tracks import FACE_TRACK, VOICE_TRACK
from pica_client.voice.sound.process import SoundProcess
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, PeerUpdated, Track

pytestmark = pytest.mark.unit

VOICE_FRAME = Frame(stream=1, sequence=0, captured_us=0, payload=b"")


class Seats(SoundProcess):
    """Sound that notes who is seated, and makes none."""

    def __init__(self) -> None:
        super().__init__()
        self.said: list[dict[str, float]] = []

    def seat(self, azimuths_rad: Mapping[str, float]) -> None:
        self.said.append(dict(azimuths_rad))

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        assert peer_id in self.said[-1]


def person(peer_id: str, *kinds: str) -> Peer:
    tracks = tuple(Track(kind=kind, stream=ord(peer_id[0])) for kind in kinds)
    return Peer(peer_id=peer_id, name=peer_id, tracks=tracks)


def test_each_has_a_place_until_they_leave() -> None:
    sound = Seats()
    hearing = Hearing(sound)
    call = Call(AvatarLibrary(()), ears=hearing)
    people = (person("ada", FACE_TRACK), person("eve"), person("ben", VOICE_TRACK))
    call.receive_event(Joined(room="r", peer_id="me", peers=people), now=0.0)
    call.receive_event(PeerJoined(peer=person("cho", VOICE_TRACK)), now=1.0)
    call.receive_event(PeerUpdated(peer_id="eve", metadata=(("records", "yes"),)), now=2.0)
    for peer_id in ("ada", "ben", "cho", "ben"):
        hearing.receive(peer_id, VOICE_FRAME, 2.0)
    for peer_id in ("ben", "ada", "eve", "cho"):
        call.receive_event(PeerLeft(peer_id=peer_id), now=3.0)
    assert sound.said == [
        {"ada": -WIDTH_RAD, "ben": WIDTH_RAD},
        {"ada": -WIDTH_RAD, "ben": 0.0, "cho": WIDTH_RAD},
        {"ada": -WIDTH_RAD, "cho": WIDTH_RAD},
        {"cho": 0.0},
        {},
    ]
