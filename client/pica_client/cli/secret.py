"""`pica secret`: make what the people of a call share beforehand."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.output import say


@dataclass(frozen=True, kw_only=True, slots=True)
class SecretOptions:
    """Options of `pica secret`."""

    file: Path = field(kw_only=False)
    """File to write; it must not be there yet."""


def secret(options: SecretOptions) -> dict[str, Any]:
    """Make a room secret for calls that the relay cannot look into.

    Give the file to everybody in the call, on a way that is not the relay's, and name it with
    --secret-file. Nothing of it is shown here.
    """
    save_secret(options.file, RoomSecret.new())
    say(f"wrote {options.file}; hand it to the others, and use it with --secret-file")
    return {"file": str(options.file)}
