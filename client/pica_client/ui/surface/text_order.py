"""Text in the order and the shapes in which it is drawn: Hebrew and Arabic run to the left. Pure.

ImGui sets one glyph beside the other, from left to right. What is written to the left is turned
round before (Unicode's bidirectional algorithm, by python-bidi), and Arabic letters get the shape
that their neighbours ask for (by arabic-reshaper). Marks of Indian scripts are not rearranged.
"""

from functools import lru_cache

import arabic_reshaper
from bidi import get_display

FIRST_TO_THE_LEFT = 0x590
"""First code point of the scripts that run to the left: Hebrew."""


@lru_cache(maxsize=1024)
def as_drawn(text: str) -> str:
    """A text as glyphs from left to right."""
    if all(ord(char) < FIRST_TO_THE_LEFT for char in text):
        return text
    return str(get_display(arabic_reshaper.reshape(text)))
