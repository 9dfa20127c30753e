"""Files of a user: whole on a full disk, for their eyes alone; and what is said in a terminal."""

import os
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pica_client.avatars.fetch import AvatarCache
from pica_client.e2ee.secret import RoomSecret, load_secret, save_secret
from pica_client.errors import OptionError, SealError
from pica_client.system import say
from pica_client.ui.recorder import save_png
from pica_client.ui.state import PreferencesFile, ViewState
from pica_core.files import FOLDERS
from pica_server.cli.token import TokenOptions, token
from pica_server.config import ConfigurationError
from pica_server.tokens import load_keys

pytestmark = pytest.mark.unit


@contextmanager
def room_for(num_bytes: int) -> Iterator[None]:
    """Let no file grow beyond so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (num_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_what_was_there_stays_whole(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    path = tmp_path / "file"
    save_png(path, noise)
    before = path.read_bytes()
    with room_for(1000), pytest.raises(OptionError, match="file: cannot be written: File too"):
        save_png(path, noise)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    path.unlink()
    with room_for(1000), pytest.raises(OptionError):
        save_png(path, noise)
    assert list(tmp_path.iterdir()) == []


def test_half_a_secret_does_not_stand_in_the_way_of_the_next_try(tmp_path: Path) -> None:
    path = tmp_path / "room.secret"
    with room_for(20), pytest.raises(SealError, match="cannot be written: File too large"):
        save_secret(path, RoomSecret.new())
    save_secret(path, RoomSecret.new())
    load_secret(path)


def test_half_a_key_does_not_spoil_the_key_file(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    options = TokenOptions(keys=path, new_key=True)
    with room_for(20), pytest.raises(ConfigurationError):
        token(options)
    assert not path.exists()
    token(options)
    first = path.read_bytes()
    with room_for(len(first) + 10), pytest.raises(ConfigurationError):
        token(options)
    assert path.read_bytes() == first
    load_keys(path)


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
