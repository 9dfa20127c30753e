"""Each system's folders are those where earlier versions kept their files."""

import sys
from pathlib import Path

import pytest
from platformdirs import PlatformDirs, windows
from platformdirs.macos import MacOS
from platformdirs.unix import Unix

from pica_client.user_folders import cache_folder, preferences_folder

pytestmark = pytest.mark.unit

HOME = Path.home()


@pytest.mark.parametrize(
    ("system", "environment", "cache", "preferences"),
    [
        (Unix, {}, HOME / ".cache/pica-telepresence", HOME / ".config/pica-telepresence"),
        (
            Unix,
            {"XDG_CACHE_HOME": "/c", "XDG_CONFIG_HOME": "/p"},
            "/c/pica-telepresence",
            "/p/pica-telepresence",
        ),
        (
            Unix,
            {"XDG_CACHE_HOME": "relative", "XDG_CONFIG_HOME": "relative"},
            HOME / ".cache/pica-telepresence",
            HOME / ".config/pica-telepresence",
        ),
        (
            MacOS,
            {},
            HOME / "Library/Caches/pica-telepresence",
            HOME / "Library/Application Support/pica-telepresence",
        ),
        (
            windows.Windows,
            {"LOCALAPPDATA": "/local", "APPDATA": "/roaming"},
            "/local/pica-telepresence/Cache",
            "/roaming/pica-telepresence",
        ),
    ],
)
def test_files_are_where_the_platform_has_them_and_where_they_were(
    system: type[PlatformDirs],
    environment: dict[str, str],
    cache: str | Path,
    preferences: str | Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(windows, "get_win_folder", windows.get_win_folder_from_env_vars)
    assert cache_folder(system) == Path(cache, "avatars")
    assert preferences_folder(system) == Path(preferences)


def test_preferences_that_were_kept_on_a_mac_before_are_still_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", "/p")
    assert preferences_folder(MacOS) == Path("/p/pica-telepresence")
    former = tmp_path / "Library/Application Support/pica-telepresence"
    former.mkdir(parents=True)
    assert preferences_folder(MacOS) == former
