"""Which avatars stay loaded, which one is worn by default, and who gives its file to the relay."""

from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.avatars import library as module
from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import GiveAvatar, avatar_by_name, giver_of
from pica_client.local_call.local_call import NAMES
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.file import save_avatar, shipped_avatar_files

pytestmark = pytest.mark.unit

SHIPPED = [path.stem for path in shipped_avatar_files()]


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


def test_the_people_of_the_examples_look_different_though_nobody_chose() -> None:
    assert len({avatar_by_name(name, SHIPPED) for name in NAMES[:6]}) == len(SHIPPED) == 6


def test_everybody_looks_the_same_in_each_call_however_the_name_is_typed() -> None:
    for name, alike in (("Ada", " ada "), ("José", "Jose\u0301")):
        assert avatar_by_name(name, SHIPPED) == avatar_by_name(alike, SHIPPED)
    assert [avatar_by_name(name.title(), SHIPPED) for name in SHIPPED] == list(SHIPPED)


@pytest.mark.parametrize(
    ("ships", "is_encrypted", "give", "is_given"),
    [
        (True, False, "auto", False),
        (False, False, "auto", True),
        (False, True, "auto", False),
        (False, True, "yes", True),
        (True, False, "yes", True),
        (False, False, "no", False),
    ],
)
def test_the_relay_gets_a_file_that_others_lack_unless_it_could_look_at_it(
    tmp_path: Path, *, ships: bool, is_encrypted: bool, give: GiveAvatar, is_given: bool
) -> None:
    path = shipped_avatar_files()[0] if ships else tmp_path / "me.pica"
    link = LinkConfig(secret_file=tmp_path / "secret" if is_encrypted else None)
    assert (giver_of(path, "5" * 64, link, print, give) is not None) is is_given
