"""Files of a user are for their eyes alone."""

import os
import stat
from pathlib import Path

import pytest

from pica_client.avatars.fetch import AvatarCache
from pica_client.system import FOLDERS, say
from pica_client.ui.state import PreferencesFile, ViewState

pytestmark = pytest.mark.unit


@pytest.mark.skipif(os.name != "posix", reason="files have no such modes")
def test_what_is_kept_of_a_user_is_for_their_eyes_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    cache, preferences = FOLDERS.user_cache_path / "avatars", FOLDERS.user_config_path
    for folder in (cache, preferences):
        folder.mkdir(parents=True)
        folder.chmod(0o755)
    AvatarCache().keep("5" * 64, b"an avatar")
    PreferencesFile().save(ViewState(name="Ada"))
    for path, mode in (
        (cache, 0o700),
        (preferences, 0o700),
        (preferences / "preferences.json", 0o600),
    ):
        assert stat.S_IMODE(path.stat().st_mode) == mode


def test_what_strangers_call_themselves_steers_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say("several faces: \x1b[2J\x1b]0;evil\x07é, Ünal\nnext \x9b31m")
    assert capsys.readouterr().err == "several faces:  [2J ]0;evil é, Ünal\nnext  31m\n"
