"""`pica avatar push` and `pica avatar measure`."""

import asyncio
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pica_client.avatars.upload import push_avatar
from pica_client.output import check_writable, say
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import avatar_id, load_avatar, save_avatar
from pica_core.avatar.shipped import avatar_file


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarPushOptions:
    """Options of `pica avatar push`."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""
    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    token_file: Path | None = None
    """File with a join token that allows to wear this avatar, see pica token."""
    ca_file: Path | None = None
    """Trust the certificates of this PEM file instead of the system's, at a wss:// address."""


def avatar_push(options: AvatarPushOptions) -> dict[str, Any]:
    """Give a relay an avatar's file, for receivers that do not have it.

    Checks it first, as receivers do. `pica send` gives the avatar that it wears by itself.
    """
    link = LinkConfig(url=options.url, token_file=options.token_file, ca_file=options.ca_file)
    file = avatar_file(options.file)
    load_avatar(file)
    identity = avatar_id(file)
    shown = -1

    def show(ratio: float) -> None:
        nonlocal shown
        if sys.stderr.isatty() and int(ratio * 100) > shown:
            shown = int(ratio * 100)
            print(f"\r{shown} %", end="\n" if ratio == 1 else "", file=sys.stderr, flush=True)

    stored = asyncio.run(push_avatar(link.url, link, file, identity, show))
    say(f"{file}: the relay {'has it now' if stored.is_new else 'had it already'}")
    return {"sha256": identity, "was_there": not stored.is_new}


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarMeasureOptions:
    """Options of `pica avatar measure`."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""
    out: Path
    """Avatar file to write, with the table of errors in it; may be the same."""


def avatar_measure(options: AvatarMeasureOptions) -> dict[str, Any]:
    """Measure an avatar's levels of detail; write the table of errors into its file."""
    from pica_client.avatars.level_errors import measure_levels, with_errors

    check_writable(options.out, ".pica")
    avatar = load_avatar(avatar_file(options.file))
    errors = measure_levels(avatar, lambda ratio: say(f"{ratio:.0%}"))
    save_avatar(options.out, with_errors(avatar, errors))
    rows: list[dict[str, Any]] = []
    full = avatar.levels[-1]
    for mesh, by_maps in zip(errors.levels, errors.mse.tolist(), strict=True):
        ways = {mesh: by_maps[0], full: by_maps[1]}  # the full level's two are one
        for level, by_height in ways.items():
            rows.append({"level": level, "mesh": mesh, "mse": by_height})
            figures = "  ".join(
                f"{height:g} px {error:.1f}"
                for height, error in zip(errors.head_px.tolist(), by_height, strict=True)
            )
            say(f"maps of {level} on the mesh of {mesh}: MSE {figures}")
    say(f"wrote {options.out}")
    return {
        "name": avatar.manifest.name,
        "sha256": avatar_id(options.out),
        "head_px": errors.head_px.tolist(),
        "rows": rows,
        "view_mse_per_rad2": errors.view_mse_per_rad2,
        "latent_mse_per_unit2": errors.latent_mse_per_unit2,
    }
