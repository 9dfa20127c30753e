"""The receiver's state: who is there, what is wrong with whom, and the numbers about it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.senders import LoadedAvatars
from helpers.stream_toy import Sent, perform
from helpers.toy import make_toy_avatar, toy_payload
from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call, Ears
from pica_client.errors import OptionError
from pica_client.tracks import FACE_KEY, FACE_LOST
from pica_core.avatar.file import Avatar, save_avatar
from pica_core.codec.latent_stream import LatentDecoder
from pica_core.errors import AvatarFileError
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, PeerUpdated, Track

pytestmark = pytest.mark.unit

TOY = make_toy_avatar()
TOY_ID = "a" * 64


def peer(peer_id: str, name: str, stream: int, avatar: str = TOY_ID, kind: str = "face") -> Peer:
    track = Track(kind=kind, avatar=avatar, stream=stream)
    return Peer(peer_id=peer_id, name=name, tracks=(track,))


def frame(stream: int, sequence: int, captured_us: int, value: float = 1.0) -> Frame:
    payload = toy_payload(value)
    return Frame(stream=stream, sequence=sequence, captured_us=captured_us, payload=payload)


def joined(*peers: Peer) -> Joined:
    return Joined(room="r", peer_id="me", peers=peers)


class Places(Ears):
    """Notes whose voices have a place, and whose packets come."""

    def __init__(self) -> None:
        self.seated: list[list[str]] = []
        self.heard: list[str] = []

    def seat(self, peer_ids: Sequence[str]) -> None:
        self.seated.append(list(peer_ids))

    def receive(self, peer_id: str, packet: Frame, arrived_s: float) -> None:
        self.heard.append(peer_id)


def test_each_with_a_face_or_a_voice_has_a_place_until_they_leave() -> None:
    ears = Places()
    call = Call(LoadedAvatars({TOY_ID: TOY}), ears=ears)
    watcher = Peer(peer_id="eve", name="Eve")
    call.receive_event(joined(peer("ada", "Ada", 1), watcher), now=0.0)
    call.receive_event(PeerJoined(peer=peer("ben", "Ben", 2, kind="voice")), now=1.0)
    call.receive_event(frame(2, 0, 0), now=1.0)
    for peer_id in ("ada", "eve", "ben"):
        call.receive_event(PeerLeft(peer_id=peer_id), now=2.0)
    assert ears.seated == [["ada"], ["ada", "ben"], ["ben"], ["ben"], []]
    assert ears.heard == ["ben"]


@pytest.fixture
def call() -> Call:
    return Call(LoadedAvatars({TOY_ID: TOY}))


def test_a_peer_waits_until_its_first_frame_is_due(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7)), now=0.0)
    (face,) = call.faces(0.1)
    assert (face.name, face.status, face.latent) == ("Ada", "waiting", None)
    call.receive_event(frame(7, 0, 1_000_000), now=0.2)
    (face,) = call.faces(0.21)
    assert face.status == "live"
    assert face.captured_us == 1_000_000
    assert face.latent is not None
    assert face.latent == pytest.approx(LatentDecoder(TOY).decode(toy_payload(1.0)).latent)


def test_who_rests_keeps_the_face_that_is_shown(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7)), now=0.0)
    assert call.faces(0.1, resting={"p1"})[0].latent is None
    for number in range(3):
        call.receive_event(frame(7, number, 100_000 * number), now=0.1 * number)
    before = call.faces(0.21)[0].captured_us
    assert call.faces(0.3, resting={"p1"})[0].captured_us == before
    assert call.faces(0.3, resting={"p2"})[0].captured_us > before


def test_a_silent_peer_becomes_stale_and_lives_again(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7)), now=0.0)
    call.receive_event(frame(7, 0, 0), now=0.0)
    assert call.faces(0.1)[0].status == "live"
    assert call.faces(2.5)[0].status == "stale"
    call.receive_event(frame(7, 1, 3_000_000), now=3.0)
    assert call.faces(3.01)[0].status == "live"


def test_a_peer_without_a_face_track_has_no_seat(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1, kind="voice")), now=0.0)
    assert call.faces(0.0) == []


class DamagedAvatars:
    """A store in which every file is there and damaged."""

    def get(self, identity: str) -> Avatar | None:
        raise AvatarFileError(f"{identity[:8]}: cut or damaged")

    def note(self, identity: str) -> str:
        return ""


def test_a_damaged_avatar_costs_its_peer_the_face_and_nobody_the_call() -> None:
    call = Call(DamagedAvatars())
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(PeerJoined(peer=peer("p2", "Ben", 2)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    assert [face.status for face in call.faces(0.1)] == ["waiting", "waiting"]
    assert call.errors == 0
    with pytest.raises(AvatarFileError, match="cut or damaged"):
        call.avatar(TOY_ID)


def test_rates_are_counted_from_the_beginning_of_the_window(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    for index in range(90):
        now = index / 30
        if index == 30:
            call.begin_window(now)
        call.receive_event(frame(1, index, round(now * 1e6)), now=now)
        call.faces(now + 0.001)
    stats = call.stats(3.0)
    (ada,) = stats["peers"]
    assert stats["seconds"] == 2.0
    assert ada["latents_per_s"] == 30.0
    assert ada["concealed_ratio"] == 0
    assert ada["playout_delay_ms"] == pytest.approx(33.3, abs=1.5)


def test_a_library_finds_avatars_by_name_file_and_hash(tmp_path: Path) -> None:
    shipped = tmp_path / "ada.pica"
    other = tmp_path / "other.pica"
    save_avatar(shipped, make_toy_avatar(seed=1))
    save_avatar(other, make_toy_avatar(seed=2))
    library = AvatarLibrary(shipped=[shipped])
    identity = library.find("ada")
    assert library.load(identity).manifest.identity == "toy-1"
    assert library.get(identity) is not None
    assert library.load(library.find(str(other))).manifest.identity == "toy-2"
    with pytest.raises(OptionError, match="'bob' is unknown; shipped are: ada, other"):
        library.find("bob")
    with pytest.raises(AvatarFileError, match=r"none\.pica"):
        library.find(str(tmp_path / "none.pica"))
    with pytest.raises(AvatarFileError, match=r"missing here: get bbbbbbbb .* --avatar"):
        library.get("b" * 64)
    library.close()


def test_a_damaged_file_is_an_error_each_time_without_keeping_the_last(tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.pica"
    damaged.write_bytes(b"no avatar at all")
    library = AvatarLibrary(shipped=[damaged])
    identity = library.find("damaged")
    with pytest.raises(AvatarFileError, match=r"damaged\.pica"):
        library.load(identity)
    errors = []
    for _ in range(2):
        why = r"avatar file is refused: "
        with pytest.raises(AvatarFileError, match=why) as raised:
            library.get(identity)
        errors.append(raised.value)
    assert errors[0] is not errors[1]
    library.close()


def play(call: Call, num_frames: int) -> list[Sent]:
    """A performance arrives; gives its frames."""
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    sent = perform(num_frames=num_frames)
    for each in sent:
        coded = replace(frame(1, each.number, each.captured_us), payload=each.payload)
        call.receive_event(coded, now=each.captured_us / 1e6)
    return sent


def test_a_stream_is_played(call: Call) -> None:
    sent = play(call, 60)
    (face,) = call.faces(59.5 / 30)
    assert (face.status, face.note) == ("live", "")
    assert call.errors == 0
    assert face.latent is not None
    assert np.abs(face.latent - sent[-1].decoded().latent).max() < 1


def test_payloads_that_cannot_be_read_are_counted_and_the_face_is_held(call: Call) -> None:
    play(call, 8)
    before = call.faces(0.3)[0].latent
    for number, payload in enumerate((b"\0", b"\xff" * 513, bytes(1000)), start=8):
        broken = Frame(stream=1, sequence=number, captured_us=number * 33_333, payload=payload)
        call.receive_event(broken, now=0.3)
    assert call.errors == 3
    after = call.faces(0.31)[0].latent
    assert before is not None
    assert after is not None
    assert np.abs(after - before).max() < 1


def test_after_coming_back_to_the_same_room_seats_stay_with_their_ids(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7), peer("p2", "Bob", 8)), now=0.0)
    call.receive_event(frame(7, 0, 0), now=0.1)
    told = replace(peer("p1", "Ada", 7), metadata=(("hand", "up"),))
    call.receive_event(
        Joined(room="r", peer_id="me", peers=(told, peer("p3", "Cyd", 9)), resumed=True), now=1.0
    )
    assert [face.name for face in call.faces(1.1)] == ["Ada", "Cyd"]
    assert call.faces(1.1)[0].latent is not None


def test_a_peer_that_says_something_else_of_itself_keeps_its_seat_in_another_room(
    call: Call,
) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7)), now=0.0)
    call.receive_event(frame(7, 0, 0), now=0.1)
    call.receive_event(PeerUpdated(peer_id="p1", metadata=(("hand", "up"),)), now=0.2)
    call.receive_event(joined(peer("p1", "Ada", 7)), now=1.0)
    assert call.faces(1.1)[0].latent is not None
    call.receive_event(joined(peer("p1", "Eve", 7)), now=2.0)
    assert call.faces(2.1)[0].latent is None
    for stream, other in enumerate((peer("p1", "Eve", 8), peer("p1", "Bob", 9)), 8):
        call.receive_event(Joined(room="r", peer_id="me", peers=(other,), resumed=True), now=3.0)
        call.receive_event(frame(stream, 0, 0), now=3.1)
        assert [(face.name, face.latent is None) for face in call.faces(3.2)] == [
            (other.name, False)
        ]


def test_a_face_is_away_while_its_tracker_sees_nobody(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    statuses = []
    for says in (FACE_LOST, "", "odd"):
        told = PeerUpdated(peer_id="p1", metadata=((FACE_KEY, says),))
        call.receive_event(told, now=0.0)
        statuses.append(call.faces(0.1)[0].status)
    assert statuses == ["away", "live", "live"]
