"""Invite links and the desktop: the file that says which command opens them."""

from __future__ import annotations

import configparser
import shlex
import sys
from pathlib import Path

import pytest

from pica_client.errors import OptionError
from pica_client.ui.joining.link_handler import desktop_entry, register_links

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("python", ["/usr/bin/python3", '/home/a "b" $c/50%/python'])
def test_the_entry_runs_the_interpreter_that_has_us(python: str) -> None:
    parser = configparser.RawConfigParser()
    parser.read_string(desktop_entry(python))
    entry = parser["Desktop Entry"]
    assert entry["MimeType"] == "x-scheme-handler/pica;"
    # The desktop undoes the escapes of a string first, then those of the command.
    command = shlex.split(entry["Exec"].replace("\\\\", "\\").replace("\\$", "$"))
    assert command == [python.replace("%", "%%"), "-m", "pica_command", "view", "%u"]


def test_the_file_is_written_where_applications_are(tmp_path: Path) -> None:
    path = register_links(tmp_path / "applications", system="linux")
    assert sys.executable in path.read_text()
    assert register_links(tmp_path / "applications", system="linux") == path


@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_where_there_are_no_such_files_it_is_said_what_to_do(system: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="paste an invite link"):
        register_links(tmp_path, system=system)
    assert not list(tmp_path.iterdir())
