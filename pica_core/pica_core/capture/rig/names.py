"""Which shapes of a rig drive which ARKit shape: by rules over names, then by a table of the user.

Names propose, movement decides: a shape that moves nothing drives nothing, and shapes of one
meaning that move different vertices (Maya names them after their meshes) drive together.

eyeBlink_L  Eye_Blink_Left  head.eyeBlinkLeft  EYEBLINKLEFT  A14_Eye_Blink_Left  -> eyeBlinkLeft
eyeBlink.L  jawOpen.001 (Blender)  head_bs_jawOpen           -> eyeBlinkLeft, jawOpen
browInnerUp_L + browInnerUp_R                                                    -> browInnerUp
blink_l, blinkLeft, Fcl_EYE_Close_L (VRM, VRoid)   -> eyeBlinkLeft, where nothing fits better
mouthSmile (one shape for both sides)           -> its halves drive mouthSmileLeft and ...Right
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.capture.dataset.multiface import read_json
from pica_core.errors import CaptureError
from pica_core.types import BoolArray

SIDES = {"l": "Left", "left": "Left", "lft": "Left", "r": "Right", "right": "Right", "rgt": "Right"}
_PLAIN = {name.lower(): name for name in ARKIT_NAMES}
_STEMS = {
    name.removesuffix("Left").lower()
    for name in ARKIT_NAMES
    if name.endswith("Left") and name.removesuffix("Left") + "Right" in ARKIT_INDEX
} - {"jaw", "mouth"}
"""ARKit names without their side, of those that have sides; jawLeft is a direction, no side."""
_VRM = {
    "blink": "eyeBlink", "blinkleft": "eyeBlinkLeft", "blinkright": "eyeBlinkRight",
    "blinkl": "eyeBlinkLeft", "blinkr": "eyeBlinkRight",
    "aa": "jawOpen", "ih": "mouthStretch", "ou": "mouthPucker", "ee": "mouthSmile",
    "oh": "mouthFunnel",
    "a": "jawOpen", "i": "mouthStretch", "u": "mouthPucker", "e": "mouthSmile",
    "o": "mouthFunnel",
    "lookup": "eyeLookUp", "lookdown": "eyeLookDown",
    "fcleyeclosel": "eyeBlinkLeft", "fcleyecloser": "eyeBlinkRight", "fcleyeclose": "eyeBlink",
    "fcleyespread": "eyeWide", "fclbrwangry": "browDown", "fclbrwsurprised": "browOuterUp",
    "fclbrwsorrow": "browInnerUp", "fclmtha": "jawOpen", "fclmthi": "mouthStretch",
    "fclmthu": "mouthPucker", "fclmthe": "mouthSmile", "fclmtho": "mouthFunnel",
    "fclmthfun": "mouthSmile", "fclmthdown": "mouthFrown",
}  # fmt: skip
"""Expressions of VRM 0.x and 1.0 and shapes of VRoid, which come nearest to ARKit's (chosen).

Moods of a whole face (joy, angry, ...) are left out: they would close eyes that ought to be open.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Driver:
    """A part that one source shape plays in an ARKit shape."""

    source: str
    """Name in the file."""
    half: str = ""
    """``Left`` or ``Right``: only that half of the source shape; empty: the whole of it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NameMap:
    """How a rig's shapes drive the 52 ARKit shapes."""

    drivers: dict[str, tuple[Driver, ...]]
    """What drives each ARKit shape; displacements add up."""
    mapped: tuple[str, ...]
    """Source shapes that drive something, in the file's order."""
    missing: tuple[str, ...]
    """ARKit shapes that nothing drives, in ARKit's order."""
    ignored: tuple[str, ...]
    """Source shapes that drive nothing, in the file's order."""


def match_name(source: str) -> tuple[tuple[str, str], ...]:
    """What a name means: ARKit names, each with the half of the shape that drives it.

    Returns:
        Nothing for a name that means nothing to us; two entries for one shape of both sides.
    """
    meant = _match(source)
    first, *rest = re.split(r"[_\- ]+", source, maxsplit=1)
    # Words before a name go, unless they are one: a corrective is named after two.
    if meant or not rest or _match(first) or _near(_letters(rest[0])):
        return meant
    return match_name(rest[0])


def _letters(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _match(source: str) -> tuple[tuple[str, str], ...]:
    """What a name means as a whole, as `match_name`."""
    *before, last = re.split(r"[.:|/]", re.sub(r"[._\- ]\d+$", "", source))
    if before and last.lower() in SIDES:
        last = f"{before[-1]}_{last}"
    last = re.sub(r"^[A-Za-z]?\d+[_\- ]+", "", last)
    plain = _letters(last)
    if plain in _PLAIN:
        return ((_PLAIN[plain], ""),)
    if meant := _near(plain):
        sides = ("Left", "Right") if meant.lower() in _STEMS else ()
        return tuple((meant + side, side) for side in sides) or ((meant, ""),)
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", last)
    for at in (-1, 0):
        side = SIDES.get(words[at].lower()) if len(words) > 1 else None
        if side is None:
            continue
        stem = "".join(words[:-1] if at == -1 else words[1:]).lower()
        if stem in _STEMS:
            return ((_PLAIN[stem + side.lower()], ""),)
        if stem in _PLAIN:  # half of a shape that ARKit has in one piece
            return ((_PLAIN[stem], ""),)
    if plain in _STEMS:
        return tuple((_PLAIN[plain + side.lower()], side) for side in ("Left", "Right"))
    return ()


def _near(plain: str) -> str | None:
    """What an expression of VRM or a shape of VRoid comes near to."""
    return _VRM.get(plain[max(plain.find("fcl"), 0) :])


def read_names(path: Path) -> dict[str, str | None]:
    """A user's table: ``{"source name": "arkitName" or null}``."""
    table = read_json(path)
    for name, target in table.items():
        if target is not None and target not in ARKIT_INDEX:
            raise CaptureError(f"{path}: {name!r} is mapped to {target!r}, which is no ARKit name")
    return table


def map_names(
    names: Sequence[str],
    table: dict[str, str | None] | None = None,
    moved: Mapping[str, BoolArray] | None = None,
) -> NameMap:
    """Map a rig's shape names, in the file's order; the user's table goes before the rules.

    Args:
        names: Names of the rig's shapes.
        table: Names that the user maps, see `read_names`.
        moved: Vertices that each shape moves, bool ``[V]``; without it all move alike.

    Raises:
        CaptureError: The table names a shape that is not there, or no name is known.
    """
    table = table or {}
    unknown = [name for name in table if name not in names]
    if unknown:
        raise CaptureError(f"map: {unknown[0]!r} is no shape of the rig")
    found: dict[str, dict[str, list[Driver]]] = {name: {} for name in ARKIT_NAMES}
    for name in names:
        target = table.get(name)
        meanings = match_name(name) if name not in table else ((target, ""),) if target else ()
        if moved is not None and not moved[name].any():
            meanings = ()
        for arkit, half in meanings:
            kind = "table" if name in table else _kind(name, arkit, half)
            found[arkit].setdefault(kind, []).append(Driver(source=name, half=half))
    drivers: dict[str, tuple[Driver, ...]] = {}
    for arkit, by_kind in found.items():
        # One name may be there twice (eyeBlinkLeft and eyeBlink_L); the better match drives.
        best = min(by_kind, key=_RANK.index, default="")
        if not best:
            continue
        chosen = by_kind[best]
        if best in ("whole", "near"):
            order = sorted(chosen, key=lambda each: (bool(each.half), not _match(each.source)))
            chosen = _apart(order, moved)
        if best == "half":
            sides = {_side(driver.source): "" for driver in chosen}
            of_sides = [[d for d in chosen if _side(d.source) == side] for side in sorted(sides)]
            chosen = [driver for drivers in of_sides for driver in _apart(drivers, moved)]
        drivers[arkit] = tuple(chosen)
    used = {driver.source for chosen in drivers.values() for driver in chosen}
    if not used:
        raise CaptureError(
            f"none of {len(names)} shapes has a name that is known ({', '.join(names[:5])}, ...); "
            "give a table with --map"
        )
    return NameMap(
        drivers=drivers,
        mapped=tuple(name for name in names if name in used),
        missing=tuple(name for name in ARKIT_NAMES if name not in drivers),
        ignored=tuple(name for name in names if name not in used),
    )


def _apart(drivers: Sequence[Driver], moved: Mapping[str, BoolArray] | None) -> list[Driver]:
    """The first of some drivers that mean the same, and those that move other vertices than it."""
    chosen = list(drivers[:1])
    if moved is not None:
        taken = moved[drivers[0].source].copy()
        for driver in drivers[1:]:
            if not (taken & moved[driver.source]).any():
                chosen.append(driver)
                taken |= moved[driver.source]
    return chosen


_RANK = ("table", "whole", "half", "both", "near")
"""How well a source fits: by the table, as a whole, as one half, as one shape for two, as an
expression that only comes near."""


def _side(name: str) -> str:
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return SIDES.get(words[-1].lower(), "") or SIDES.get(words[0].lower(), "")


def _kind(name: str, arkit: str, half: str) -> str:
    if arkit.lower() not in (plain := _letters(name)) and _near(plain):
        return "near"
    if half:
        return "both"
    sided = arkit.endswith(("Left", "Right"))
    return "half" if not sided and _side(name) else "whole"
