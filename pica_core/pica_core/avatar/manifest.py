"""The manifest of an avatar file: who it is, its sizes and its scales, read from JSON without
trust."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

from pica_core.avatar.spec import LATENT_CHANNELS, AvatarSpec
from pica_core.avatar.variants import VARIANTS
from pica_core.errors import AvatarFileError

SCHEMA_VERSION = 1
MAX_TEXT = 200
MAX_CARD_ENTRIES = 64
MAX_CARD_TEXT = 2000
MAX_POSITION_SCALE_M = 10.0
MAX_EXTENT_M = 10.0
MAX_LATENT = 1e3
DRAWN_VARIANTS = tuple(name for name, row in VARIANTS.items() if row.network == "pixel_codec")
"""Variants that an avatar file may hold."""


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
    latent_scale: tuple[float, float, float, float]
    """Largest absolute latent value per channel; the plain 8-bit step is this / 127."""
    bounds_min_m: tuple[float, float, float]
    """Lower corner of all positions of the head, head frame, metres."""
    bounds_max_m: tuple[float, float, float]
    """Upper corner."""
    variant: str = "full"
    """One of `DRAWN_VARIANTS`; its encoding must be the spec's."""
    model_card: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """What it was trained on, with which command, how well it does; free text by key."""
    schema_version: int = SCHEMA_VERSION

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `manifest_from_json` reads them back."""
        values: dict[str, Any] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, AvatarSpec):
                value = value.to_json()
            elif isinstance(value, Mapping):
                value = dict(value)
            elif isinstance(value, tuple):
                value = list(value)
            values[item.name] = value
        return values


def manifest_from_json(values: Any, where: str) -> Manifest:
    """Read a manifest.

    Args:
        values: Parsed JSON, of any type.
        where: Name of the file, for messages.

    Raises:
        AvatarFileError: A field is missing, unknown, of the wrong type, or out of range.
    """
    if not isinstance(values, dict):
        raise AvatarFileError(f"{where}: manifest is {type(values).__name__}; a map is needed")
    version = values.get("schema_version")
    if version != SCHEMA_VERSION or type(version) is not int:
        raise AvatarFileError(
            f"{where}: manifest.schema_version is {version!r:.40}; "
            f"this program reads {SCHEMA_VERSION}"
        )
    known = {item.name for item in fields(Manifest)}
    if wrong := sorted(known.symmetric_difference(values)):
        raise AvatarFileError(f"{where}: manifest field {wrong[0]!r:.80} is missing or unknown")
    try:
        spec = AvatarSpec.from_json(values["spec"])
    except ValueError as error:
        raise AvatarFileError(f"{where}: manifest.spec: {error}") from error
    text = {
        key: _text(where, key, values[key]) for key in ("name", "identity", "licence", "variant")
    }
    if text["variant"] not in DRAWN_VARIANTS:
        raise AvatarFileError(
            f"{where}: manifest.variant is {text['variant']!r:.40}; "
            f"known are {', '.join(DRAWN_VARIANTS)}"
        )
    wanted = VARIANTS[text["variant"]].encoding
    if spec.encoding != wanted:
        raise AvatarFileError(
            f"{where}: manifest.spec.encoding is {spec.encoding!r}; "
            f"variant {text['variant']} has {wanted!r}"
        )
    low = _numbers(where, values, "bounds_min_m", 3, -MAX_EXTENT_M, MAX_EXTENT_M)
    high = _numbers(where, values, "bounds_max_m", 3, -MAX_EXTENT_M, MAX_EXTENT_M)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise AvatarFileError(f"{where}: manifest.bounds_min_m is not below bounds_max_m")
    scale = _numbers(where, values, "latent_scale", LATENT_CHANNELS, 1e-6, MAX_LATENT)
    return Manifest(
        name=text["name"],
        identity=text["identity"],
        licence=text["licence"],
        variant=text["variant"],
        spec=spec,
        position_scale_m=_number(
            where, "position_scale_m", values["position_scale_m"], 1e-9, MAX_POSITION_SCALE_M
        ),
        latent_scale=(scale[0], scale[1], scale[2], scale[3]),
        bounds_min_m=(low[0], low[1], low[2]),
        bounds_max_m=(high[0], high[1], high[2]),
        model_card=_card(where, values["model_card"]),
    )


def _text(where: str, field_name: str, value: object, limit: int = MAX_TEXT) -> str:
    if not isinstance(value, str) or not 1 <= len(value) <= limit or not value.isprintable():
        raise AvatarFileError(
            f"{where}: manifest.{field_name} must be 1 to {limit} printable characters"
        )
    return value


def _number(where: str, field_name: str, value: object, low: float, high: float) -> float:
    if type(value) not in (int, float) or not low <= float(value) <= high:  # type: ignore[arg-type]
        raise AvatarFileError(
            f"{where}: manifest.{field_name} is {value!r:.40}; "
            f"a number from {low:g} to {high:g} is needed"
        )
    return float(value)  # type: ignore[arg-type]


def _numbers(
    where: str, values: Mapping[str, Any], name: str, count: int, low: float, high: float
) -> list[float]:
    found = values[name]
    if not isinstance(found, list) or len(found) != count:
        raise AvatarFileError(f"{where}: manifest.{name} must be {count} numbers")
    return [_number(where, name, value, low, high) for value in found]


def _card(where: str, value: object) -> Mapping[str, str]:
    if not isinstance(value, dict) or len(value) > MAX_CARD_ENTRIES:
        raise AvatarFileError(
            f"{where}: manifest.model_card must be a map of at most {MAX_CARD_ENTRIES} entries"
        )
    card: dict[str, str] = {}
    for key, text in value.items():
        shown = text.replace("\n", " ") if isinstance(text, str) else text
        _text(where, "model_card key", key, MAX_TEXT)
        _text(where, f"model_card.{key:.40}", shown, MAX_CARD_TEXT)
        card[key] = text
    return MappingProxyType(card)
