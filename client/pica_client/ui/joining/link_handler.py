"""Let the desktop open invite links with `pica view`: each system in its own way, for this user.

Linux has a .desktop file; Windows a few keys of the registry, imported from a .reg file; macOS an
applet, since links come there as events and not as arguments. Only the first was tried on its
system; of the others the contents are tested.
"""

import plistlib
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from platformdirs import user_data_path

from pica_client.errors import OptionError
from pica_client.output import make_folder, writing
from pica_protocol.invite import SCHEME

TITLE = "PiCA Telepresence"
TOOL_TIMEOUT_S = 30.0
LSREGISTER = (
    "/System/Library/Frameworks/CoreServices.framework/Frameworks/LaunchServices.framework"
    "/Support/lsregister"
)


def desktop_entry(python: str) -> str:
    """The text of the .desktop file: which command opens a link."""
    quoted = python
    for sign in '\\"`$':  # (Desktop Entry Specification 1.5, "The Exec key")
        quoted = quoted.replace(sign, f"\\{sign}")
    quoted = quoted.replace("\\", "\\\\").replace("%", "%%")
    return (
        "[Desktop Entry]\n"
        "Type=Application\n"
        f"Name={TITLE}\n"
        f'Exec="{quoted}" -P -m pica_command view %u\n'
        "NoDisplay=true\n"
        "Terminal=false\n"
        f"MimeType=x-scheme-handler/{SCHEME};\n"
    )


def registry_entries(python: str) -> str:
    """The text of the .reg file. What stands behind `--` is never taken for an option: Windows
    hands a link over as it is, and a quote in it ends the argument."""

    def quoted(text: str) -> str:
        return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'

    key = f"HKEY_CURRENT_USER\\Software\\Classes\\{SCHEME}"
    command = f'"{python}" -P -m pica_command view -- "%1"'
    text = (
        "Windows Registry Editor Version 5.00\n\n"
        f"[{key}]\n@={quoted(f'URL:{TITLE}')}\n"
        '"URL Protocol"=""\n\n'
        f"[{key}\\shell\\open\\command]\n@={quoted(command)}\n"
    )
    return text.replace("\n", "\r\n")


def applet_script(python: str) -> str:
    """The AppleScript of the applet: what it does with a link."""
    quoted = python.replace("\\", "\\\\").replace('"', '\\"')
    return (
        "on open location theLink\n"
        f'    do shell script quoted form of "{quoted}" & " -P -m pica_command view -- " & ¬\n'
        '        quoted form of theLink & " > /dev/null 2>&1 &"\n'
        "end open location\n"
    )


def register_links(
    folder: Path | None = None,
    *,
    system: str = sys.platform,
    run: Callable[[list[str]], None] | None = None,
) -> Path:
    """Make this user's desktop open invite links with `pica view`.

    Args:
        folder: Where the file goes; by default where this user has such files.
        system: As `sys.platform`.
        run: Runs a command of the system; by default as a process.

    Returns:
        The file or applet that was written.

    Raises:
        OptionError: This system has no such files, one cannot be written, or a command failed.
    """
    run = run or _run
    python = sys.executable
    if system.startswith(("linux", "freebsd")):
        path = (folder or user_data_path() / "applications") / "pica-telepresence-links.desktop"
        _write(path, desktop_entry(python).encode())
        for command in (
            ["update-desktop-database", str(path.parent)],
            ["xdg-mime", "default", path.name, f"x-scheme-handler/{SCHEME}"],
        ):
            if folder is None and shutil.which(command[0]):
                with suppress(OptionError):  # where they fail, the desktop reads the file itself
                    run(command)
    elif system == "win32":
        path = (folder or user_data_path("pica-telepresence", False)) / "links.reg"
        _write(path, registry_entries(python).encode("utf-16"))
        run(["reg", "import", str(path)])
    elif system == "darwin":
        path = (folder or Path.home() / "Applications") / f"{TITLE}.app"
        script = path.with_suffix(".applescript")
        _write(script, applet_script(python).encode())
        run(["osacompile", "-o", str(path), str(script)])
        _claim_scheme(path / "Contents" / "Info.plist")
        run([LSREGISTER, "-f", str(path)])
    else:
        raise OptionError(
            "register-links: nobody knows how links are registered here; paste an invite link into "
            "the first field of the form, or give it to pica view"
        )
    return path


def _claim_scheme(path: Path) -> None:
    """Say in an applet's list of properties that it opens our links."""
    try:
        properties = plistlib.loads(path.read_bytes())
    except (OSError, plistlib.InvalidFileException) as error:
        raise OptionError(f"register-links: osacompile made no {path}: {error}") from error
    properties["CFBundleIdentifier"] = "org.pica-telepresence.links"
    kinds = [{"CFBundleURLName": TITLE, "CFBundleURLSchemes": [SCHEME]}]
    _write(path, plistlib.dumps(properties | {"CFBundleURLTypes": kinds}))


def _write(path: Path, content: bytes) -> None:
    make_folder(path.parent)
    with writing(path):
        path.write_bytes(content)


def _run(command: list[str]) -> None:
    """Run a command of the desktop.

    Raises:
        OptionError: It does not exist or failed.
    """
    try:
        subprocess.run(command, check=True, timeout=TOOL_TIMEOUT_S, capture_output=True)
    except (OSError, subprocess.SubprocessError) as error:
        raise OptionError(f"register-links: {error}") from error
