"""Texts as little pictures: what is written over the call, its look and its size. Pillow, no GPU.

item = OverlayItem(key="name:peer-1", lines=(("Ada", ""),), x_px=480, y_px=420)
item_size_px(item)          # columns and rows that it covers
set_item(item)              # premultiplied RGBA, uint8 [H, W, 4]
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

Style = Literal["label", "panel", "table", "banner", "form"]
Tone = Literal["plain", "good", "warning", "alert", "accent"]
Lines = Sequence[tuple[str, ...]]
Ink = tuple[int, int, int]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

MAX_LINES = 40
MAX_COLUMNS = 16
MAX_CHARACTERS = 120
"""Per text; longer ones are cut, so no name can fill the screen or the memory."""
FALLBACK_FONTS = (
    "DejaVuSans.ttf",
    "NotoSans-Regular.ttf",
    "segoeui.ttf",
    "Arial Unicode.ttf",
    "arial.ttf",
    "Arial.ttf",
    "LiberationSans-Regular.ttf",
)
"""For what Pillow's own font lacks, which is all but ASCII and a few signs: the first of these that
the machine has."""
FALLBACK_FONTS_EAST = (
    "NotoSansCJK-Regular.ttc",
    "DroidSansFallbackFull.ttf",
    "DroidSansFallback.ttf",
    "wqy-zenhei.ttc",
    "msyh.ttc",
    "malgun.ttf",
    "YuGothM.ttc",
    "PingFang.ttc",
    "Hiragino Sans GB.ttc",
    "Arial Unicode.ttf",
)
"""Fonts for Chinese, Japanese and Korean, tried before the others."""
EAST_FROM = 0x2E80
"""First code point of their scripts."""
OWN_SIGNS = frozenset("…·°±´©«»")

_INK = (240, 242, 245)
_FAINT = (165, 174, 186)
_PLATE = (16, 19, 24)
_FIELD = (34, 40, 50)
_FIELD_IN_USE = (52, 66, 92)
_TONES: dict[Tone, Ink] = {
    "plain": (150, 158, 170),
    "good": (92, 200, 130),
    "warning": (238, 180, 70),
    "alert": (232, 96, 88),
    "accent": (96, 160, 245),
}
_BANNERS: dict[Tone, Ink] = {
    "plain": _PLATE,
    "good": (22, 66, 42),
    "warning": (92, 62, 10),
    "alert": (104, 28, 26),
    "accent": (24, 54, 104),
}
"""Plates of banners: dark enough for light ink."""
_FORM_VALUE_EMS = 22
"""Width of an input field, in heights of the type: most addresses fit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OverlayItem:
    """One text on the screen."""

    key: str
    """Identifies its texture from frame to frame."""
    lines: tuple[tuple[str, ...], ...]
    """The texts of each line. label and banner: plain and faint, centred; panel: left and right;
    table: its columns, the first line is their heads; form: a label and what stands in its field,
    or one text alone."""
    x_px: float
    y_px: float
    """Anchor in image pixels, y down: the upper left corner of a panel, table or form, the middle
    of the upper edge of a label or banner."""
    style: Style = "label"
    is_right_aligned: bool = False
    """A panel's anchor is its upper right corner."""
    size_px: int = 16
    """Height of the type."""
    tone: Tone = "plain"
    """Colour of a banner, and of a form's last line when that is no field."""
    dot: Tone | None = None
    """A dot of this colour before the first line of a label or banner."""
    highlight: int | None = None
    """The line of a form whose field is in use."""
    num_heads: int = 1
    """Lines of a table, from the first on, that are heads: fainter."""

    @property
    def content(self) -> tuple[Any, ...]:
        """All that decides how the texture looks."""
        look = (self.style, self.size_px, self.tone, self.dot, self.highlight, self.num_heads)
        return (self.lines, look)


@dataclass(frozen=True, slots=True)
class _Text:
    """One text in its place: `x` and `y` as `anchor` says, in pixels of the plate."""

    text: str
    font: Font
    x: float
    y: float
    anchor: str
    ink: Ink


@dataclass(frozen=True, slots=True)
class _Plate:
    """A set item before it is drawn."""

    width: int
    height: int
    texts: list[_Text]
    opacity: int
    colour: Ink = _PLATE
    fields: tuple[tuple[float, float, float, float, Ink], ...] = ()
    """Left, top, right, bottom and colour of input fields."""
    dot: tuple[float, float, float, Ink] | None = None
    """Middle, radius and colour."""


def item_size_px(item: OverlayItem) -> tuple[int, int]:
    """Columns and rows that an item covers."""
    plate = _arrange(item)
    return plate.width, plate.height


def item_rect_px(item: OverlayItem, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of an item on a picture of `size`; it is moved to lie inside."""
    width, height = item_size_px(item)
    left, top = corner_px(item, (width, height), size)
    return left, top, left + width, top + height


def corner_px(
    item: OverlayItem, item_size: tuple[int, int], size: tuple[int, int]
) -> tuple[int, int]:
    """The upper left corner of an item of known size, moved to lie inside the picture."""
    share = 0.5 if item.style in ("label", "banner") else float(item.is_right_aligned)
    left, top = round(item.x_px - share * item_size[0]), round(item.y_px)
    return (
        min(max(left, 0), max(size[0] - item_size[0], 0)),
        min(max(top, 0), max(size[1] - item_size[1], 0)),
    )


def set_item(item: OverlayItem) -> npt.NDArray[np.uint8]:
    """Set an item on its rounded plate.

    Returns:
        Premultiplied RGBA, uint8 ``[H, W, 4]``.
    """
    plate = _arrange(item)
    size = (plate.width, plate.height)
    image = PillowImage.new("RGB", size, plate.colour)
    alpha = _rounded(*size, 0.7 * item.size_px, plate.opacity)
    draw, opaque = ImageDraw.Draw(image), ImageDraw.Draw(alpha)
    for left, top, right, bottom, colour in plate.fields:
        width, height = round(right - left), round(bottom - top)
        place = (round(left), round(top))
        shape = _rounded(width, height, 0.3 * item.size_px, 255)
        image.paste(colour, place, shape)
        alpha.paste(245, place, shape)
    if plate.dot is not None:
        x, y, radius, colour = plate.dot
        side = round(2 * radius)
        shape = _rounded(side, side, radius, 255)
        place = (round(x - radius), round(y - radius))
        image.paste(colour, place, shape)
        alpha.paste(255, place, shape)
    for each in plate.texts:
        draw.text((each.x, each.y), each.text, each.ink, each.font, each.anchor)
        opaque.text((each.x, each.y), each.text, 255, each.font, each.anchor)
    rgb, a = np.asarray(image, np.uint16), np.asarray(alpha, np.uint16)[..., None]
    premultiplied = np.concatenate([(rgb * a + 127) // 255, a], axis=-1)
    return np.ascontiguousarray(premultiplied, np.uint8)


def _arrange(item: OverlayItem) -> _Plate:
    rows = [
        tuple(_printable(text) for text in line[:MAX_COLUMNS]) or ("",)
        for line in item.lines[:MAX_LINES]
    ]
    match item.style:
        case "panel":
            return _panel(rows, item.size_px)
        case "table":
            return _table(rows, item)
        case "form":
            return _form(rows, item)
        case _:
            return _label(rows, item)


def _label(rows: list[tuple[str, ...]], item: OverlayItem) -> _Plate:
    """Centred lines: the first text plain, what follows fainter and smaller."""
    size_px, small_px = item.size_px, round(0.82 * item.size_px)
    is_banner = item.style == "banner"
    leading = round(1.25 * size_px)
    pad_x, pad_y = round(0.65 * size_px), round(0.34 * size_px)
    if is_banner:
        pad_x, pad_y = round(1.1 * size_px), round(0.6 * size_px)
    dot_px = 0.0 if item.dot is None else 0.85 * size_px
    fonts = [
        tuple(_font(text, small_px if n else size_px) for n, text in enumerate(row)) for row in rows
    ]
    widths = [
        sum(font.getlength(text) for text, font in zip(row, chosen, strict=True))
        for row, chosen in zip(rows, fonts, strict=True)
    ]
    if widths:
        widths[0] += dot_px
    width = math.ceil(max(widths, default=0.0)) + 2 * pad_x
    texts = []
    for index, (row, chosen) in enumerate(zip(rows, fonts, strict=True)):
        y = pad_y + leading * (index + 0.5)
        x = (width - widths[index]) / 2 + (dot_px if index == 0 else 0.0)
        for number, (text, font) in enumerate(zip(row, chosen, strict=True)):
            faint = (205, 210, 218) if is_banner else _FAINT
            texts.append(_Text(text, font, x, y, "lm", faint if number else _INK))
            x += font.getlength(text)
    dot = None
    if item.dot is not None and widths:
        middle = (width - widths[0]) / 2 + 0.28 * size_px
        dot = (middle, pad_y + leading / 2, 0.26 * size_px, _TONES[item.dot])
    return _Plate(
        width,
        leading * len(rows) + 2 * pad_y,
        texts,
        225 if is_banner else 150,
        _BANNERS[item.tone] if is_banner else _PLATE,
        dot=dot,
    )


def _panel(rows: list[tuple[str, ...]], size_px: int) -> _Plate:
    """Two columns, left and right."""
    pad_x, pad_y, leading = round(0.9 * size_px), round(0.75 * size_px), round(1.42 * size_px)
    pairs = [(row[0], row[1] if len(row) > 1 else "") for row in rows]
    inner = max(
        (
            _font(left, size_px).getlength(left) + _font(right, size_px).getlength(right)
            for left, right in pairs
        ),
        default=0.0,
    )
    # In steps of the type's height: a number that gains a digit does not resize the texture.
    inner = math.ceil((inner + 1.6 * size_px) / size_px) * size_px
    width = math.ceil(inner) + 2 * pad_x
    texts = []
    for index, (left, right) in enumerate(pairs):
        y = pad_y + leading * (index + 0.5)
        ink = _FAINT if right else _INK
        texts.append(_Text(left, _font(left, size_px), pad_x, y, "lm", ink))
        texts.append(_Text(right, _font(right, size_px), width - pad_x, y, "rm", _INK))
    return _Plate(width, leading * len(rows) + 2 * pad_y, texts, 205)


def _table(rows: list[tuple[str, ...]], item: OverlayItem) -> _Plate:
    """Columns: the first from the left, the others from the right, their heads faint."""
    size_px = item.size_px
    pad_x, pad_y, leading = round(0.9 * size_px), round(0.6 * size_px), round(1.36 * size_px)
    gap = round(0.9 * size_px)
    count = max((len(row) for row in rows), default=0)
    columns = []
    for column in range(count):
        longest = max(
            (
                _font(row[column], size_px).getlength(row[column])
                for row in rows
                if column < len(row)
            ),
            default=0.0,
        )
        columns.append(math.ceil(longest / size_px) * size_px)
    ends = [pad_x + sum(columns[: n + 1]) + n * gap for n in range(count)]
    width = (ends[-1] if ends else pad_x) + pad_x
    texts = []
    for index, row in enumerate(rows):
        y = pad_y + leading * (index + 0.5)
        for column, text in enumerate(row):
            x, anchor = (pad_x, "lm") if column == 0 else (ends[column], "rm")
            ink = _FAINT if index < item.num_heads else _INK
            texts.append(_Text(text, _font(text, size_px), x, y, anchor, ink))
    return _Plate(width, leading * len(rows) + 2 * pad_y, texts, 205)


def _form(rows: list[tuple[str, ...]], item: OverlayItem) -> _Plate:
    """Labels with input fields; a line of one text stands alone, the first of them as title."""
    size_px = item.size_px
    pad, leading = _form_measures(size_px)
    field_px = _FORM_VALUE_EMS * size_px
    labels = [_font(row[0], size_px).getlength(row[0]) for row in rows if len(row) > 1]
    left_px = math.ceil(max(labels, default=0.0)) + size_px
    width = 2 * pad + left_px + field_px
    texts, fields = [], []
    for index, row in enumerate(rows):
        y = pad + leading * (index + 0.5)
        font = _font(row[0], size_px)
        if len(row) == 1:
            is_last = index == len(rows) - 1
            ink = _TONES[item.tone] if is_last and item.tone != "plain" else _FAINT
            texts.append(
                _Text(
                    _end_within(row[0], font, width - 2 * pad, keep_end=False),
                    font,
                    pad,
                    y,
                    "lm",
                    _INK if index == 0 else ink,
                )
            )
            continue
        texts.append(_Text(row[0], font, pad, y, "lm", _FAINT))
        left, top = pad + left_px, y - 0.85 * size_px
        colour = _FIELD_IN_USE if index == item.highlight else _FIELD
        fields.append((left, top, left + field_px, top + 1.7 * size_px, colour))
        value = _font(row[1], size_px)
        shown = _end_within(row[1], value, field_px - size_px, keep_end=True)
        texts.append(_Text(shown, value, left + 0.5 * size_px, y, "lm", _INK))
    return _Plate(width, leading * len(rows) + 2 * pad, texts, 235, fields=tuple(fields))


def form_line_at(item: OverlayItem, y_px: float) -> int:
    """Which line of a form is at a height of the picture; it may be none that there is."""
    pad, leading = _form_measures(item.size_px)
    return math.floor((y_px - round(item.y_px) - pad) / leading)


def _form_measures(size_px: int) -> tuple[int, int]:
    """Space around a form, and from line to line."""
    return round(1.6 * size_px), round(2.1 * size_px)


def _end_within(text: str, font: Font, width_px: float, *, keep_end: bool) -> str:
    """The part of a text that fits: where one writes, the end matters."""
    if font.getlength(text) <= width_px:
        return text
    while text and font.getlength(text + "…") > width_px:
        text = text[1:] if keep_end else text[:-1]
    return "…" + text if keep_end else text + "…"


def _rounded(width: int, height: int, radius: float, opacity: int) -> PillowImage.Image:
    """A rounded rectangle as an alpha image; drawn large and reduced, for Pillow does not
    smooth."""
    scale = 4
    large = PillowImage.new("L", (width * scale, height * scale), 0)
    corners = (0, 0, width * scale - 1, height * scale - 1)
    ImageDraw.Draw(large).rounded_rectangle(corners, radius * scale, fill=opacity)
    return large.resize((width, height), PillowImage.Resampling.LANCZOS)


def _printable(text: str) -> str:
    shown = "".join(char if char.isprintable() else " " for char in text)
    return shown if len(shown) <= MAX_CHARACTERS else shown[: MAX_CHARACTERS - 1] + "…"


def _font(text: str, size_px: int) -> Font:
    if all(char.isascii() or char in OWN_SIGNS for char in text):
        return _load_font("own", size_px)
    return _load_font("east" if any(ord(char) >= EAST_FROM for char in text) else "rest", size_px)


@lru_cache(maxsize=32)
def _load_font(script: Literal["own", "rest", "east"], size_px: int) -> Font:
    names = {"own": (), "rest": FALLBACK_FONTS, "east": FALLBACK_FONTS_EAST + FALLBACK_FONTS}
    for name in names[script]:
        with suppress(OSError):
            return ImageFont.truetype(name, size_px)
    # The machine has none of them: boxes instead of letters, but a name all the same.
    return ImageFont.load_default(size_px)
