"""Files of a user are in the folders of their system, for their eyes alone."""

import os
import stat
from pathlib import Path

import pytest
from platformdirs import PlatformDirs, windows
from platformdirs.macos import MacOS
from platformdirs.unix import Unix

from pica_client.avatars.fetch import AvatarCache
from pica_client.system import cache_folder, preferences_folder, say
from pica_client.ui.state import PreferencesFile, ViewState

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
def test_files_are_where_the_platform_has_them(
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


@pytest.mark.skipif(os.name != "posix", reason="files have no such modes")
def test_what_is_kept_of_a_user_is_for_their_eyes_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for folder in (cache_folder(), preferences_folder()):
        folder.mkdir(parents=True)
        folder.chmod(0o755)
    AvatarCache().keep("5" * 64, b"an avatar")
    PreferencesFile().save(ViewState(name="Ada"))
    for path, mode in (
        (cache_folder(), 0o700),
        (preferences_folder(), 0o700),
        (preferences_folder() / "preferences.json", 0o600),
    ):
        assert stat.S_IMODE(path.stat().st_mode) == mode


def test_what_strangers_call_themselves_steers_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say("several faces: \x1b[2J\x1b]0;evil\x07é, Ünal\nnext \x9b31m")
    assert capsys.readouterr().err == "several faces:  [2J ]0;evil é, Ünal\nnext  31m\n"
