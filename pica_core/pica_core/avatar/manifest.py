"""The manifest of an avatar file: who it is, its sizes and its scales, read from JSON without
trust."""

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, field, fields
from types import MappingProxyType
from typing import Any

from pica_core.avatar.spec import AvatarSpec

SCHEMA_VERSION = 1
MAX_TEXT = 200
MAX_CARD_ENTRIES = 64
MAX_CARD_TEXT = 2000
MAX_POSITION_SCALE_M = 10.0
MAX_EXTENT_M = 0.45
"""How far an avatar reaches from its head's origin along an axis: a bust takes 0.21 m to a side and
0.40 m down, and what is drawn stays in the box, so that none sits in another's seat."""


@dataclass(frozen=True, slots=True)
class ViewSpan:
    """The directions that a head was seen from in training, degrees, in its own axes."""

    min_yaw: float
    max_yaw: float
    """Positive is towards +x, the head's left."""
    min_pitch: float
    max_pitch: float
    """Positive is from above."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """What an avatar file says about itself."""

    name: str
    """Name to show, up to 200 characters."""
    identity: str
    """Which capture identity it was trained on."""
    licence: str
    """SPDX identifier, or a sentence."""
    spec: AvatarSpec
    position_scale_m: float
    """Metres per unit of the geometry decoder's output."""
    bounds_min_m: tuple[float, float, float]
    """Lower corner of all positions of the head, head frame, metres."""
    bounds_max_m: tuple[float, float, float]
    """Upper corner of all positions of the head, head frame, metres."""
    view_span: ViewSpan
    """The directions that it may be seen from."""
    model_card: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """What it was trained on, with which command, how well it does; free text by key."""
    schema_version: int = SCHEMA_VERSION

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `from_json` reads them back."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        for name in ("bounds_min_m", "bounds_max_m"):
            values[name] = list(values[name])
        values["view_span"] = list(astuple(self.view_span))
        return values | {"spec": asdict(self.spec), "model_card": dict(self.model_card)}

    @classmethod
    def from_json(cls, values: Any) -> "Manifest":
        """Read a manifest from parsed JSON of any type.

        Raises:
            ValueError: A field is missing, unknown, of the wrong type, or out of range.
        """
        if not isinstance(values, dict):
            raise ValueError(f"manifest is {type(values).__name__}; a map is needed")
        version = values.get("schema_version")
        if version != SCHEMA_VERSION or type(version) is not int:
            raise ValueError(
                f"manifest.schema_version is {version!r:.40}; this program reads {SCHEMA_VERSION}"
            )
        known = {item.name for item in fields(cls)}
        if wrong := sorted(known.symmetric_difference(values)):
            raise ValueError(f"manifest field {wrong[0]!r:.80} is missing or unknown")
        try:
            spec = AvatarSpec.from_json(values["spec"])
        except ValueError as error:
            raise ValueError(f"manifest.spec: {error}") from error
        found: dict[str, Any] = {
            key: _text(key, values[key]) for key in ("name", "identity", "licence")
        }
        corners = {
            name: _numbers(values, name, 3, -MAX_EXTENT_M, MAX_EXTENT_M)
            for name in ("bounds_min_m", "bounds_max_m")
        }
        if not all(a < b for a, b in zip(*corners.values(), strict=True)):
            raise ValueError("manifest.bounds_min_m is not below bounds_max_m")
        span = ViewSpan(*_numbers(values, "view_span", 4, -180.0, 180.0))
        if not (span.min_yaw < 0 < span.max_yaw and span.min_pitch < 0 < span.max_pitch):
            raise ValueError("manifest.view_span does not hold the view from the front")
        scale_m = values["position_scale_m"]
        found |= {
            **corners,
            "view_span": span,
            "position_scale_m": _number("position_scale_m", scale_m, 1e-9, MAX_POSITION_SCALE_M),
        }
        return cls(spec=spec, model_card=_card(values["model_card"]), **found)


def _text(name: str, value: object, limit: int = MAX_TEXT) -> str:
    if not isinstance(value, str) or not 1 <= len(value) <= limit or not value.isprintable():
        raise ValueError(f"manifest.{name} must be 1 to {limit} printable characters")
    return value


def _number(name: str, value: Any, low: float, high: float) -> float:
    if type(value) not in (int, float) or not low <= value <= high:
        raise ValueError(
            f"manifest.{name} is {value!r:.40}; a number from {low:g} to {high:g} is needed"
        )
    return float(value)


def _numbers(
    values: Mapping[str, Any], name: str, count: int, low: float, high: float
) -> tuple[Any, ...]:
    """So many numbers of a manifest's field, each within a range; ValueError if it is other."""
    found = values[name]
    if not isinstance(found, list) or len(found) != count:
        raise ValueError(f"manifest.{name} must be {count} numbers")
    return tuple(_number(name, value, low, high) for value in found)


def _card(value: object) -> Mapping[str, str]:
    if not isinstance(value, dict) or len(value) > MAX_CARD_ENTRIES:
        raise ValueError(f"manifest.model_card must be a map of at most {MAX_CARD_ENTRIES} entries")
    for key, text in value.items():
        _text("model_card key", key)
        shown = text.replace("\n", " ") if isinstance(text, str) else text
        _text(f"model_card.{key:.40}", shown, MAX_CARD_TEXT)
    return MappingProxyType(dict(value))
