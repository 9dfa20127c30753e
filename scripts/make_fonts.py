"""Cut the viewer's fonts out of Noto: the characters that names are written with, without features.

    apt-get install fonts-noto-core fonts-noto-cjk        or --root FOLDER, where they are unpacked
    npm pack @fontsource/noto-emoji && tar xf fontsource-noto-emoji-*.tgz
    python scripts/make_fonts.py package

Needs fonttools with brotli (`pip install 'fonttools[woff]'`). The fonts are under the SIL Open Font
License 1.1, which lies beside them. The surface draws one glyph a character, so ligatures, kerning
and vertical writing are left out. Of Chinese, Japanese and Korean the characters of GB 2312, of the
first level of JIS X 0208 and of KS X 1001 stay.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from fontTools import merge, subset
from fontTools.ttLib import TTCollection, TTFont

OUT = Path(__file__).resolve().parent.parent / "client/pica_client/ui/surface/font_files"
SCRIPTS: dict[str, list[tuple[int, int]]] = {
    "Arabic": [(0x600, 0x700), (0x750, 0x780), (0xFB50, 0xFE00), (0xFE70, 0xFF00)],
    "Armenian": [(0x530, 0x590)],
    "Devanagari": [(0x900, 0x980), (0x200C, 0x200E), (0x25CC, 0x25CD)],
    "Georgian": [(0x10A0, 0x1100), (0x1C90, 0x1CC0)],
    "Hebrew": [(0x590, 0x600), (0xFB1D, 0xFB50)],
    "Thai": [(0xE00, 0xE80)],
}
"""Ranges of code points of each script."""
KEPT_NAMES = [0, 1, 2, 5, 13, 14]
LAYOUT = ["vhea", "vmtx", "VORG", "BASE", "GPOS", "GSUB", "GDEF"]


def save(font: TTFont, characters: set[int], name: str) -> None:
    """Write the part of a font that has these characters."""
    options = subset.Options()
    options.layout_features, options.hinting, options.name_IDs = [], False, KEPT_NAMES
    options.notdef_outline = True
    options.drop_tables += LAYOUT
    subsetter = subset.Subsetter(options)
    subsetter.populate(unicodes=characters)
    subsetter.subset(font)
    font.save(OUT / name)
    print(f"{name}: {len(font.getBestCmap())} characters, {(OUT / name).stat().st_size:,} bytes")


def charset(codec: str, first: range, second: range = range(0xA1, 0xFF)) -> set[int]:
    """The characters of an encoding of two bytes."""
    pairs = (bytes([high, low]).decode(codec, "ignore") for high in first for low in second)
    return {ord(each) for pair in pairs for each in pair}


def emoji(package: Path) -> TTFont:
    """All parts of the emoji font as one."""
    with tempfile.TemporaryDirectory() as folder:
        parts = []
        for path in sorted(package.glob("files/noto-emoji-[0-9]*-400-normal.woff2")):
            font = TTFont(path)
            font.flavor = None
            for table in {"GSUB", "GPOS", "GDEF"} & set(font.keys()):
                del font[table]
            parts.append(f"{folder}/{path.stem}.ttf")
            font.save(parts[-1])
        return merge.Merger().merge(parts)


def main() -> None:
    """Write all of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("emoji_package", type=Path)
    parser.add_argument("--root", type=Path, default=Path("/"))
    options = parser.parse_args()
    noto = options.root / "usr/share/fonts"
    for script, ranges in SCRIPTS.items():
        characters = {each for low, high in ranges for each in range(low, high)}
        font = TTFont(noto / f"truetype/noto/NotoSans{script}-Regular.ttf")
        save(font, characters, f"NotoSans{script}.ttf")
    fonts = TTCollection(noto / "opentype/noto/NotoSansCJK-Regular.ttc").fonts
    chinese = next(each for each in fonts if each["name"].getDebugName(4) == "Noto Sans CJK SC")
    characters = charset("gb2312", range(0xA1, 0xF8)) | charset("euc_jp", range(0xA1, 0xD0))
    characters |= charset("euc_kr", range(0xB0, 0xC9))
    characters = {each for each in characters if each >= 0x2E80}
    characters |= {*range(0x3000, 0x3100), *range(0xFF00, 0xFF70)}
    save(chinese, characters, "NotoSansCJKsc-common.otf")
    font = emoji(options.emoji_package)
    save(font, set(font.getBestCmap()) - set(range(0x20, 0x7F)), "NotoEmoji.ttf")


if __name__ == "__main__":
    main()
