"""Invite links and the desktop: the files that say which command opens them."""

from __future__ import annotations

import configparser
import plistlib
import shlex
import sys
from pathlib import Path

import pytest

from pica_client.errors import OptionError
from pica_client.ui.joining.link_handler import (
    applet_script,
    desktop_entry,
    register_links,
    registry_entries,
)

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("python", ["/usr/bin/python3", '/home/a "b" $c/50%/python'])
def test_the_entry_runs_the_interpreter_that_has_us(python: str) -> None:
    parser = configparser.RawConfigParser()
    parser.read_string(desktop_entry(python))
    entry = parser["Desktop Entry"]
    assert entry["MimeType"] == "x-scheme-handler/pica;"
    # The desktop undoes the escapes of a string first, then those of the command.
    command = shlex.split(entry["Exec"].replace("\\\\", "\\").replace("\\$", "$"))
    assert command == [python.replace("%", "%%"), "-P", "-m", "pica_command", "view", "%u"]


def test_the_file_is_written_where_applications_are(tmp_path: Path) -> None:
    path = register_links(tmp_path / "applications", system="linux")
    assert sys.executable in path.read_text()
    assert register_links(tmp_path / "applications", system="linux") == path


def test_on_windows_the_registry_names_the_command_and_takes_no_options_from_a_link(
    tmp_path: Path,
) -> None:
    text = registry_entries(r"C:\Program Files\Python\python.exe")
    assert text.startswith("Windows Registry Editor Version 5.00\r\n")
    assert "[HKEY_CURRENT_USER\\Software\\Classes\\pica]\r\n" in text
    assert '"URL Protocol"=""' in text
    command = text.splitlines()[-1].removeprefix('@="').removesuffix('"')
    unescaped = command.replace('\\"', '"').replace("\\\\", "\\")
    assert unescaped == r'"C:\Program Files\Python\python.exe" -P -m pica_command view -- "%1"'
    commands: list[list[str]] = []
    path = register_links(tmp_path, system="win32", run=commands.append)
    assert path.read_bytes().decode("utf-16") == registry_entries(sys.executable)
    assert commands == [["reg", "import", str(path)]]


def test_on_a_mac_an_applet_takes_the_link_and_claims_the_scheme(tmp_path: Path) -> None:
    commands: list[list[str]] = []

    def run(command: list[str]) -> None:
        commands.append(command)
        if command[0] == "osacompile":
            properties = Path(command[2]) / "Contents" / "Info.plist"
            properties.parent.mkdir(parents=True)
            properties.write_bytes(plistlib.dumps({"CFBundleExecutable": "applet"}))

    path = register_links(tmp_path, system="darwin", run=run)
    found = plistlib.loads((path / "Contents" / "Info.plist").read_bytes())
    assert found["CFBundleURLTypes"][0]["CFBundleURLSchemes"] == ["pica"]
    assert found["CFBundleExecutable"] == "applet"
    assert [command[-1] for command in commands] == [
        str(path.with_suffix(".applescript")),
        str(path),
    ]
    script = path.with_suffix(".applescript").read_text(encoding="utf-8")
    assert script == applet_script(sys.executable)
    assert "quoted form of theLink" in script


def test_an_applet_that_was_not_made_is_said(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="osacompile made no"):
        register_links(tmp_path, system="darwin", run=lambda command: None)


def test_where_nobody_knows_how_it_is_said_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="paste an invite link"):
        register_links(tmp_path, system="plan9")
    assert not list(tmp_path.iterdir())
