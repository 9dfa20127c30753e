"""The page on the wire has what peers say of themselves."""

from __future__ import annotations

import re

import pytest

from helpers.paths import ROOT
from pica_client.call.participant import FACE_NOTES
from pica_client.publish.face_track import FACE_KEY, RECORDS_KEY, RECORDS_YES
from pica_client.voice.track import VOICE_KEY, VOICE_MUTED

pytestmark = pytest.mark.unit


def test_the_page_has_every_entry_of_metadata_that_clients_know() -> None:
    page = (ROOT / "docs" / "protocol.md").read_text()
    table = page.partition("\n| key | value |")[2].partition("\n\n")[0]
    known = {(FACE_KEY, value) for value in FACE_NOTES}
    known |= {(VOICE_KEY, VOICE_MUTED), (RECORDS_KEY, RECORDS_YES)}
    assert set(re.findall(r"^\| `(\w+)` \| `(\w+)` \|", table, re.MULTILINE)) == known
