"""The receiver's state: who is there, what is wrong with whom, and the numbers about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pica_client.avatars import AvatarLibrary, LoadedAvatars
from pica_client.call import Call
from pica_client.errors import AvatarLookupError
from pica_core.avatar_file import Avatar, save_avatar
from pica_core.errors import AvatarFileError
from pica_core.plain_stream import LatentProfile, encode_latent
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, Track
from toy import make_toy_avatar

pytestmark = pytest.mark.unit

TOY = make_toy_avatar()
TOY_ID = "a" * 64
PROFILE = LatentProfile.from_manifest(TOY.manifest)


def peer(peer_id: str, name: str, stream: int, avatar: str = TOY_ID, kind: str = "face") -> Peer:
    return Peer(
        peer_id=peer_id, name=name, tracks=(Track(kind=kind, avatar=avatar, stream=stream),)
    )


def frame(stream: int, sequence: int, captured_us: int, value: float = 1.0) -> Frame:
    payload = encode_latent(np.full((8, 8, 4), value), np.zeros(3), np.zeros(3), PROFILE)
    return Frame(stream=stream, sequence=sequence, captured_us=captured_us, payload=payload)


def joined(*peers: Peer) -> Joined:
    return Joined(room="r", peer_id="me", peers=peers)


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
    assert face.latent == pytest.approx(np.ones((8, 8, 4)), abs=0.02)


def test_a_silent_peer_becomes_stale_and_lives_again(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 7)), now=0.0)
    call.receive_event(frame(7, 0, 0), now=0.0)
    assert call.faces(0.1)[0].status == "live"
    assert call.faces(2.5)[0].status == "stale"
    call.receive_event(frame(7, 1, 3_000_000), now=3.0)
    assert call.faces(3.01)[0].status == "live"


def test_peers_come_and_go_in_order_of_arrival(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(PeerJoined(peer=peer("p2", "Ben", 2)), now=0.0)
    call.receive_event(PeerJoined(peer=peer("p3", "Cho", 3)), now=0.0)
    assert [face.name for face in call.faces(0.0)] == ["Ada", "Ben", "Cho"]
    call.receive_event(PeerLeft(peer_id="p2"), now=0.0)
    call.receive_event(PeerLeft(peer_id="nobody"), now=0.0)
    assert [face.name for face in call.faces(0.0)] == ["Ada", "Cho"]


def test_an_old_peer_id_in_a_new_session_may_be_somebody_else(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1), peer("p2", "Ben", 2)), now=0.0)
    call.receive_event(joined(peer("p1", "Ben", 1), peer("p2", "Ada", 2)), now=9.0)
    call.receive_event(frame(2, 0, 0), now=9.0)
    assert [face.name for face in call.faces(9.1) if face.latent is not None] == ["Ada"]


def test_who_is_the_same_after_a_reconnect_keeps_the_seat_and_the_face(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    call.receive_event(joined(peer("p1", "Ada", 1)), now=1.0)
    assert call.faces(1.0)[0].latent is not None


def test_a_peer_without_a_face_track_has_no_seat(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1, kind="voice")), now=0.0)
    assert call.faces(0.0) == []


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\xff" * 269, bytes(1184)])
def test_a_payload_that_is_no_latent_is_counted_and_the_face_stays(
    call: Call, payload: bytes
) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    call.receive_event(Frame(stream=1, sequence=1, captured_us=33_333, payload=payload), now=0.03)
    assert call.errors == 1
    assert call.faces(0.1)[0].latent is not None


def test_a_frame_of_nobody_is_a_stray(call: Call) -> None:
    call.receive_event(joined(), now=0.0)
    call.receive_event(frame(9, 0, 0), now=0.0)
    assert (call.strays, call.errors) == (1, 0)


def test_an_avatar_that_is_not_here_is_an_error_with_the_fix_and_no_face(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1, avatar="b" * 64)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    assert call.faces(0.1)[0].status == "waiting"
    assert call.without_avatar == 1
    with pytest.raises(AvatarFileError, match=r"bbbbbbbb is not on this machine; .* --avatar"):
        call.avatar("b" * 64)


class DamagedAvatars:
    """A store in which every file is there and damaged."""

    def has(self, identity: str) -> bool:
        return True

    def get(self, identity: str) -> Avatar | None:
        raise AvatarFileError(f"{identity[:8]}: cut or damaged")


def test_a_damaged_avatar_costs_its_peer_the_face_and_nobody_the_call() -> None:
    call = Call(DamagedAvatars())
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(PeerJoined(peer=peer("p2", "Ben", 2)), now=0.0)
    call.receive_event(frame(1, 0, 0), now=0.0)
    assert [face.status for face in call.faces(0.1)] == ["waiting", "waiting"]
    assert (call.without_avatar, call.errors) == (1, 0)
    with pytest.raises(AvatarFileError, match="cut or damaged"):
        call.avatar(TOY_ID)


def test_rates_are_counted_from_the_beginning_of_the_window(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    for index in range(90):
        now = index / 30
        if index == 30:
            call.begin_window(now)
        call.receive_event(frame(1, index, round(now * 1e6)), now=now)
    stats = call.stats(3.0)
    (ada,) = stats["peers"]
    assert stats["seconds"] == 2.0
    assert ada["latents_per_s"] == 30.0
    assert ada["payload_bps"] == 30 * 269 * 8
    assert ada["longest_gap_ms"] == pytest.approx(33.3, abs=0.1)


def test_a_report_tells_what_came_since_the_last(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    # Which frames are lost is known half a second later.
    for sequence in (0, 1, *range(4, 24)):
        call.receive_event(frame(1, sequence, sequence * 33_333), now=sequence / 30)
        call.due_frames(sequence / 30 + 0.02)
    (first,) = call.take_report().streams
    assert (first.stream, first.received, first.lost, first.concealed) == (1, 22, 2, 2)
    (second,) = call.take_report().streams
    assert (second.received, second.lost) == (0, 0)


def test_what_is_wrong_with_a_stream_stands_in_its_statistics(call: Call) -> None:
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.begin_window(0.0)
    for index in range(60):
        now = index / 30
        call.receive_event(frame(1, index, round(now * 1e6)), now=now)
        if index % 10 == 5:  # twice, and once from the future
            call.receive_event(frame(1, index, round(now * 1e6)), now=now)
            call.receive_event(frame(1, index + 1, 10**12 * index), now=now)
        call.faces(now + 0.001)
    (ada,) = call.stats(2.0)["peers"]
    assert (ada["duplicates"], ada["refused"], ada["future"], ada["restarts"]) == (6, 6, 6, 0)
    assert ada["concealed_ratio"] == 0
    assert ada["age_ms"] == pytest.approx(33.3, abs=1.5)
    assert ada["playout_delay_ms"] == pytest.approx(33.3, abs=1.5)
    assert (ada["jitter_ms"], abs(ada["clock_drift_ppm"])) == (0, 0)


def test_what_is_shown_can_be_traced_back_to_its_frame() -> None:
    call = Call(LoadedAvatars({TOY_ID: TOY}), log_shown=True)
    call.receive_event(joined(peer("p1", "Ada", 1)), now=0.0)
    call.receive_event(frame(1, 0, 5_000), now=0.5)
    call.faces(0.6)
    (shown,) = call.take_shown()
    assert shown == ("Ada", 5_000, 5_000, 500_000)


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
    with pytest.raises(AvatarLookupError, match="'bob' is unknown; shipped are: ada, other"):
        library.find("bob")
    with pytest.raises(AvatarFileError, match=r"none\.pica"):
        library.find(str(tmp_path / "none.pica"))
    assert library.get("f" * 64) is None
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
        with pytest.raises(AvatarFileError, match=r"damaged\.pica") as raised:
            library.get(identity)
        errors.append(raised.value)
    assert errors[0] is not errors[1]
    library.close()


def test_a_folder_of_avatars_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(AvatarLookupError, match="nowhere is not there"):
        AvatarLibrary(folder=tmp_path / "nowhere", shipped=[])
