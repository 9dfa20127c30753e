"""Notices: how long they stand, how many, and what is not said twice."""

from __future__ import annotations

import pytest

from pica_client.ui.notice_board import LOUD_NOTICE_S, NOTICE_S, Notice, NoticeBoard

pytestmark = pytest.mark.unit


def test_a_notice_stands_for_a_while_and_a_loud_one_longer() -> None:
    board = NoticeBoard()
    board.add(Notice("Ada joined"), now=10.0)
    board.add(Notice("Ben records the call", "alert"), now=10.0)
    assert [each.text for each in board.shown(10.0 + NOTICE_S - 0.1)] == [
        "Ada joined",
        "Ben records the call",
    ]
    assert [each.text for each in board.shown(10.0 + NOTICE_S)] == ["Ben records the call"]
    assert board.shown(10.0 + LOUD_NOTICE_S) == ()


def test_the_oldest_of_many_goes_and_the_same_again_only_stays_longer() -> None:
    board = NoticeBoard()
    for text in ("one", "two", "three", "one", "four"):
        board.add(Notice(text), now=10.0)
    assert [each.text for each in board.shown(11.0)] == ["three", "one", "four"]
