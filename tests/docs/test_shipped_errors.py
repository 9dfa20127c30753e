"""The page of figures says of the shipped avatars what their files say."""

from __future__ import annotations

import re

import pytest

from helpers.paths import ROOT
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("held_out_mse", r"MSE ([\d.]+)–([\d.]+) with one sample.*Sam, sculpted: ([\d.]+)"),
        ("held_out_mse_live", r"([\d.]+)–([\d.]+) from tracker.*sculpted: [\d.]+ and ([\d.]+)"),
    ],
)
def test_errors_of_the_shipped_avatars_are_those_of_their_model_cards(
    entry: str, words: str
) -> None:
    cards = [load_avatar(path).manifest.model_card for path in shipped_avatar_files()]
    *people, sculpted = (float(card[entry].split()[0].rstrip(",")) for card in cards)

    told = re.search(words, (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8"))

    assert told is not None
    assert [float(value) for value in told.groups()] == [min(people), max(people), sculpted]
