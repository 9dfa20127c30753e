"""``scripts/house.py``: what it counts."""

import pytest

from helpers.paths import load_script

pytestmark = pytest.mark.unit

HOUSE = load_script("house")


def test_every_file_of_the_packages_has_a_room_and_nothing_imports_in_circles() -> None:
    counts = HOUSE.measure()
    assert sum(lines for lines, _ in counts["rooms"].values()) == counts["production_lines"]
    assert sum(budget for _, budget in counts["rooms"].values()) <= 42_600
    assert counts["circle"] == []
    assert counts["longest_file"] <= 500
    assert counts["largest_folder"] <= 20


def test_no_line_says_what_the_field_has_other_words_for() -> None:
    assert HOUSE.dialect() == []


def test_a_circle_is_found_however_far_around() -> None:
    found = HOUSE.circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert set(found) == {"a", "b", "c"}
