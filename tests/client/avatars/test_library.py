"""Which avatars stay loaded."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.avatars import library as module
from pica_client.avatars.library import AvatarLibrary
from pica_core.avatar.file import save_avatar

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
    first, second = library.load(a), library.load(b)
    for identity in (a, c):
        library.load(identity)
    assert library.load(a) is first
    assert library.load(b) is not second
    monkeypatch.setattr(module, "MAX_LOADED_BYTES", 1)
    assert library.load(d) is library.load(d)
    assert library.load(a) is not first
    library.close()
