"""Which avatar somebody wears who has named none, and who gives its file to the relay."""

from __future__ import annotations

from pathlib import Path

import pytest

from pica_client.avatars.upload import GiveAvatar, avatar_by_name, giver_of
from pica_client.errors import AvatarLookupError
from pica_client.local_call.local_call import NAMES
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.file import shipped_avatar_files

pytestmark = pytest.mark.unit

SHIPPED = [path.stem for path in shipped_avatar_files()]


def test_the_people_of_the_examples_look_different_though_nobody_chose() -> None:
    assert len({avatar_by_name(name, SHIPPED) for name in NAMES[:6]}) == len(SHIPPED) == 6


def test_everybody_looks_the_same_in_each_call_however_the_name_is_typed() -> None:
    for name, alike in (("Ada", " ada "), ("José", "Jose\u0301")):
        assert avatar_by_name(name, SHIPPED) == avatar_by_name(alike, SHIPPED)


def test_without_any_avatar_the_remedy_is_named() -> None:
    with pytest.raises(AvatarLookupError, match="--avatar FILE"):
        avatar_by_name("Ada", [])


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
