"""Pages say of training and of the shipped avatars what code and files say."""

from __future__ import annotations

import re

import pytest

from helpers.paths import ROOT
from pica_core.avatar.file import load_avatar
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.train.config import PAPER_LOSSES, LossConfig

pytestmark = pytest.mark.unit


def test_the_page_on_training_tells_the_weight_of_hue() -> None:
    page = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")

    assert f"plus {LossConfig().chroma:g} times the square" in page
    assert f"(λ_c {PAPER_LOSSES.chroma:g}; here {LossConfig().chroma:g})" in page


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
