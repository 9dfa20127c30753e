"""Which avatars stay loaded, and which files are kept."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path
from unittest import mock

import pytest

from helpers.toy import make_toy_avatar
from pica_client.avatars import library as module
from pica_client.avatars.fetch import AvatarCache, AvatarFetcher
from pica_client.avatars.library import AvatarLibrary
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.unit


def test_the_avatars_asked_for_longest_ago_are_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / f"{name}.pica" for name in "abcd"]
    for seed, path in enumerate(paths):
        save_avatar(path, make_toy_avatar(seed=seed))
    monkeypatch.setattr(module, "MAX_LOADED_BYTES", 2.5 * paths[0].stat().st_size)
    library = AvatarLibrary(shipped=paths)
    a, b, c, d = (library.find(path.stem) for path in paths)
    for identity in (a, b, a, c):
        library.load(identity)
    assert library.loaded() == [a, c]
    monkeypatch.setattr(module, "MAX_LOADED_BYTES", 1)
    assert library.load(d) is library.load(d)
    assert library.loaded() == [d]
    assert library.load(a) is not None
    library.close()


def await_avatar(fetcher: AvatarFetcher, identity: str) -> None:
    for _ in range(10_000):
        assert fetcher.get(identity) is None
        time.sleep(0.001)


def test_what_is_no_avatar_does_not_enter_the_cache(tmp_path: Path) -> None:
    junk = b"no avatar"
    identity = hashlib.sha256(junk).hexdigest()

    def give(relay_url: str, identity: str, to: Path, **options: object) -> None:
        to.write_bytes(junk)

    library = AvatarLibrary(shipped=[])
    with mock.patch("pica_client.avatars.fetch.download", give):
        fetcher = AvatarFetcher(library, lambda: "ws://127.0.0.1:9", cache=AvatarCache(tmp_path))
        with pytest.raises(AvatarFileError, match=r"missing: .*not an avatar file; get"):
            await_avatar(fetcher, identity)
        fetcher.close()
    library.close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_read_in_a_way_unforeseen_keeps_no_other_back(
    tmp_path: Path,
) -> None:
    save_avatar(tmp_path / "good.pica", make_toy_avatar())
    content = {
        hashlib.sha256(data).hexdigest(): data
        for data in (b"strange", (tmp_path / "good.pica").read_bytes())
    }
    strange, good = content

    def give(relay_url: str, identity: str, to: Path, **options: object) -> None:
        to.write_bytes(content[identity])

    def load(path: Path) -> Avatar:
        if path.read_bytes() == b"strange":
            raise OverflowError("nobody has thought of this")
        return load_avatar(path)

    library = AvatarLibrary(shipped=[])
    cache = AvatarCache(tmp_path / "cache")
    with (
        mock.patch("pica_client.avatars.fetch.download", give),
        mock.patch("pica_client.avatars.fetch.load_avatar", load),
    ):
        fetcher = AvatarFetcher(library, lambda: "ws://127.0.0.1:9", cache=cache)
        with pytest.raises(AvatarFileError, match="cannot be read"):
            await_avatar(fetcher, strange)
        for _ in range(10_000):
            if fetcher.get(good) is not None:
                break
            time.sleep(0.001)
        assert fetcher.get(good) is not None
        fetcher.close()
    library.close()
