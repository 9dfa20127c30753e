"""Let the desktop open invite links with `pica view`: a .desktop file, where there are such."""

import shutil
import subprocess
import sys
from pathlib import Path

from platformdirs import user_data_path

from pica_client.errors import OptionError
from pica_client.output import make_folder, writing
from pica_protocol.invite import SCHEME

FILE_NAME = "pica-telepresence-links.desktop"
TOOL_TIMEOUT_S = 10.0


def desktop_entry(python: str) -> str:
    """The text of the file: which command opens a link.

    Args:
        python: The interpreter that has PiCA.
    """
    quoted = python
    for sign in '\\"`$':  # (Desktop Entry Specification 1.5, "The Exec key")
        quoted = quoted.replace(sign, f"\\{sign}")
    quoted = quoted.replace("\\", "\\\\").replace("%", "%%")
    return (
        "[Desktop Entry]\n"
        "Type=Application\n"
        "Name=PiCA Telepresence\n"
        f'Exec="{quoted}" -m pica_command view %u\n'
        "NoDisplay=true\n"
        "Terminal=false\n"
        f"MimeType=x-scheme-handler/{SCHEME};\n"
    )


def register_links(folder: Path | None = None, *, system: str = sys.platform) -> Path:
    """Make this user's desktop open invite links with `pica view`.

    Args:
        folder: Where the file goes; by default this user's applications.
        system: As `sys.platform`.

    Returns:
        The file that was written.

    Raises:
        OptionError: This system has no such files, or it cannot be written.
    """
    if not system.startswith(("linux", "freebsd")):
        raise OptionError(
            "register-links: here links cannot be registered by a file; paste an invite link into "
            "the first field of the form, or give it to pica view"
        )
    path = (folder or user_data_path() / "applications") / FILE_NAME
    make_folder(path.parent)
    with writing(path):
        path.write_text(desktop_entry(sys.executable))
    for command in (
        ["update-desktop-database", str(path.parent)],
        ["xdg-mime", "default", FILE_NAME, f"x-scheme-handler/{SCHEME}"],
    ):
        if folder is None and shutil.which(command[0]):
            subprocess.run(command, check=False, timeout=TOOL_TIMEOUT_S, capture_output=True)
    return path
