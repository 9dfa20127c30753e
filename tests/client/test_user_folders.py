"""Files of a user are in the folders of their system, for their eyes alone."""

import os
import stat
from pathlib import Path

import pytest
from platformdirs import PlatformDirs, windows
from platformdirs.macos import MacOS
from platformdirs.unix import Unix

from pica_client.avatars.fetch import AvatarCache
from pica_client.cli.doctor import Finding, examine
from pica_client.ui.state import PreferencesFile, ViewState
from pica_client.user_folders import cache_folder, open_to_others, preferences_folder

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
    assert list(open_to_others()) == []
    for folder in (cache_folder(), preferences_folder()):
        folder.mkdir(parents=True)
        folder.chmod(0o755)
    token = tmp_path / "token"
    token.touch(0o644)
    assert list(open_to_others([token])) == [cache_folder(), preferences_folder(), token]
    assert examined()["privacy"].fix == f"chmod go= {cache_folder()} {preferences_folder()}"
    AvatarCache()
    PreferencesFile().save(ViewState(name="Ada"))
    assert list(open_to_others()) == []
    assert stat.S_IMODE((preferences_folder() / "preferences.json").stat().st_mode) == 0o600
    monkeypatch.setenv("PICA_SEND_TOKEN_FILE", str(token))
    assert examined()["privacy"].fix == f"chmod go= {token}"


def examined() -> dict[str, Finding]:
    return {each.subject: each for each in examine(has_display=lambda: False, wanted=["privacy"])}
