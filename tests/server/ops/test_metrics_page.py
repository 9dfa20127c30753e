"""The table of numbers on the operators' page has all of them."""

import re

import pytest

from helpers.paths import ROOT
from pica_server.config.relay import RelayConfig
from pica_server.ops.status_pages import LoopWatch, StatusPages
from pica_server.room.hub import Hub

pytestmark = pytest.mark.unit


def test_every_number_of_a_relay_stands_on_the_operators_page_and_no_other() -> None:
    config = RelayConfig()
    pages = StatusPages(Hub(config), LoopWatch(), config)
    page = pages.answer("/metrics", is_local=True, now=0.0)
    assert page is not None
    told = set(re.findall(r"^# TYPE pica_([a-z_]+) ", page.text, re.MULTILINE))
    operating = (ROOT / "docs" / "operating.md").read_text()
    table = operating.partition("| series | what | labels |")[2].partition("\n\n")[0]
    cells = re.findall(r"^\| ([^|]+) \|", table, re.MULTILINE)
    named = [name for cell in cells for name in re.findall(r"`([a-z_]+)`", cell)]
    assert sorted(named) == sorted(told)
