"""Chairs belong to people, not to connections."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.call.faces import FaceState
from pica_client.call.seat_order import KEPT_S, MAX_EMPTY, SeatOrder

pytestmark = pytest.mark.unit


def faces(*peers: str, avatar_id: str = "a") -> list[FaceState]:
    """People named "name-number", where the number is the connection's."""
    return [
        FaceState(peer_id=peer, name=peer.split("-")[0], avatar_id=avatar_id, latent=None)
        for peer in peers
    ]


def names(order: SeatOrder, now: float, *peers: str) -> list[str]:
    return [face.name for face in order.arrange(faces(*peers), now)]


def test_people_keep_their_chairs_when_the_relay_restarts_and_they_return_in_another_order() -> (
    None
):
    order = SeatOrder()
    assert names(order, 0.0, "ada-1", "bo-1", "cy-1") == ["ada", "bo", "cy"]
    assert names(order, 1.0) == []
    assert names(order, 3.0, "cy-2") == ["cy"]
    assert names(order, 3.1, "cy-2", "ada-2") == ["ada", "cy"]
    assert names(order, 3.2, "cy-2", "ada-2", "bo-2") == ["ada", "bo", "cy"]


def test_who_comes_new_sits_at_the_end_and_nobody_moves() -> None:
    order = SeatOrder()
    names(order, 0.0, "ada-1", "bo-1")
    assert names(order, 1.0, "new-1", "bo-1", "ada-1") == ["ada", "bo", "new"]


def test_of_two_people_of_one_name_each_finds_the_chair_of_their_avatar() -> None:
    order = SeatOrder()
    first, second = faces("ada-1", avatar_id="x"), faces("ada-2", avatar_id="y")
    order.arrange([*first, *second], 0.0)
    order.arrange([], 1.0)
    back = [*faces("ada-3", avatar_id="y"), *faces("ada-4", avatar_id="x")]
    assert [face.avatar_id for face in order.arrange(back, 2.0)] == ["x", "y"]


def test_a_pin_follows_a_person_to_the_new_connection() -> None:
    order = SeatOrder()
    names(order, 0.0, "ada-1", "bo-1")
    names(order, 1.0)
    assert order.follow("bo-1") == "bo-1"  # expected back
    names(order, 2.0, "bo-2")
    assert order.follow("bo-1") == "bo-2"
    assert order.follow("stranger-1") is None


def test_a_relay_that_deals_the_same_ids_to_others_swaps_neither_chairs_nor_pins() -> None:
    def people(*pairs: str) -> list[FaceState]:
        known = (pair.split("=") for pair in pairs)
        return [
            FaceState(peer_id=peer, name=name, avatar_id="a", latent=None) for peer, name in known
        ]

    order = SeatOrder()
    order.arrange(people("p1=ada", "p2=bo", "p3=cy"), 0.0)
    pinned: str | None = "p1"
    for now, back in enumerate((["p1=cy"], ["p1=cy", "p2=ada"], ["p1=cy", "p2=ada", "p3=bo"])):
        seated = order.arrange(people(*back), 1.0 + now)
        pinned = order.follow(pinned or "")
    assert [face.name for face in seated] == ["ada", "bo", "cy"]
    assert pinned == "p2"
    order.arrange(people("p1=cy", "p2=ada", "p3=bo"), 5.0)
    assert order.follow("p2") == "p2"


def test_a_chair_is_not_kept_for_ever() -> None:
    order = SeatOrder()
    names(order, 0.0, "ada-1", "bo-1")
    names(order, 1.0, "bo-1")
    names(order, 2.0 + KEPT_S, "bo-1")
    assert order.follow("ada-1") is None
    assert names(order, 3.0 + KEPT_S, "ada-2", "bo-1") == ["bo", "ada"]


def test_a_crowd_that_comes_and_goes_leaves_a_bounded_number_of_chairs() -> None:
    order = SeatOrder()
    for number in range(3 * MAX_EMPTY):
        names(order, float(number) * 1e-3, f"guest{number}-1")
    kept = [number for number in range(3 * MAX_EMPTY) if order.follow(f"guest{number}-1")]
    assert len(kept) <= MAX_EMPTY + 1


@given(steps=st.lists(st.lists(st.sampled_from(["a-1", "a-2", "b-1", "b-2", "c-1"]), unique=True)))
def test_exactly_those_who_are_there_have_a_chair(steps: list[list[str]]) -> None:
    order = SeatOrder()
    for number, peers in enumerate(steps):
        seated = order.arrange(faces(*peers), float(number))
        assert sorted(face.peer_id for face in seated) == sorted(peers)
