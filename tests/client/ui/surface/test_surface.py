"""The surface without a window: several at once, input, clipboard, sizes."""

from __future__ import annotations

import pytest
from imgui_bundle import imgui

from helpers.hand import open_hand
from pica_client.ui.events import KeyPressed, KeyReleased, MouseMoved
from pica_client.ui.surface.surface import Surface
from pica_client.ui.surface.theme import PALETTES, metrics_for

pytestmark = pytest.mark.unit


def test_two_surfaces_live_side_by_side() -> None:
    first = Surface((640, 360))
    second = Surface((1280, 720))
    for surface, width in ((first, 640), (second, 1280), (first, 640)):
        with surface.frame(1.0):
            assert imgui.get_io().display_size.x == width
            imgui.get_background_draw_list().add_text((0, 0), 0xFFFFFFFF, "Ada")
        assert surface.draw_data().total_vtx_count > 0
    first.close()
    first.close()
    with second.frame(2.0):
        pass
    second.close()


def test_a_field_is_pasted_into_from_the_clipboard_and_keys_are_then_its_own() -> None:
    copied: list[str] = []
    surface = Surface((640, 360))
    surface.use_clipboard(lambda: "pica://relay.example/standup", copied.append)
    text = ""

    def frame(now: float) -> None:
        nonlocal text
        with surface.frame(now):
            imgui.begin("form")
            imgui.set_keyboard_focus_here()
            _, text = imgui.input_text("##field", text)
            imgui.end()

    for step in range(3):
        frame(0.1 * step)
    assert surface.claims(KeyPressed("L"))
    assert not surface.claims(KeyPressed("Escape"))
    surface.receive(KeyPressed("V", has_control=True))
    frame(0.5)
    surface.receive(KeyReleased("V"))
    frame(0.6)
    assert text == "pica://relay.example/standup"
    assert copied == []
    surface.close()


def test_the_pointer_beside_all_panels_belongs_to_the_scene() -> None:
    with open_hand() as hand:
        hand.frame(lambda metrics: [])
        assert not hand.surface.claims(MouseMoved(100, 100))


@pytest.mark.parametrize(
    ("size", "content_scale", "low", "high"),
    [((320, 240), 1, 0.8, 0.8), ((1280, 720), 1, 1, 1), ((3840, 2160), 1, 1.7, 1.75)],
)
def test_larger_pictures_have_larger_type_within_limits(
    size: tuple[int, int], content_scale: float, low: float, high: float
) -> None:
    assert low <= metrics_for(size, content_scale).scale <= high


def test_a_display_of_twice_the_pixels_shows_the_same_points() -> None:
    assert metrics_for((2560, 1440), 2.0).scale == 2 * metrics_for((1280, 720), 1.0).scale


@pytest.mark.parametrize("mode", list(PALETTES))
def test_text_can_be_read_on_what_it_stands_on(mode: str) -> None:
    def luminance(colour: tuple[float, ...]) -> float:
        parts = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour[:3]]
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]

    palette = PALETTES[mode]  # type: ignore[index]
    for ink, ground in (
        (palette.ink, palette.card),
        (palette.faint, palette.card),
        (palette.ink, palette.field),
        (palette.on_accent, palette.accent),
    ):
        light, dark = sorted((luminance(ink), luminance(ground)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5  # (WCAG 2.2, 1.4.3)


@pytest.mark.parametrize("mode", ["dark", "light"])
def test_a_ticked_box_stands_on_the_palettes_ground(mode: str) -> None:
    surface = Surface((640, 360), mode=mode)  # type: ignore[arg-type]
    with surface.frame(1.0):
        found = imgui.get_style().color_(imgui.Col_.checkbox_selected_bg)
    surface.close()
    assert tuple(found) == pytest.approx(PALETTES[mode].field)  # type: ignore[index]
