"""The store's pure parts: the layout of a file, ranges of it, turns and slots."""

import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pica_core.avatar import file as avatar_file
from pica_server.config.relay import StoreConfig
from pica_server.errors import BusyError, ConfigurationError
from pica_server.store.downloads import answer_for
from pica_server.store.folder import AvatarFolder
from pica_server.store.store import Slots

pytestmark = pytest.mark.unit

ID = "ab" * 32


def test_no_file_is_taken_that_receivers_would_not() -> None:
    assert StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES)
    with pytest.raises(ConfigurationError, match=r"--store\.largest-bytes"):
        StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES + 1)


# Ranges

CONTENT = bytes(range(50))


@given(st.integers(0, 60), st.integers(0, 60))
def test_a_range_from_to_is_that_slice(first: int, last: int) -> None:
    answer = answer_for(ID, len(CONTENT), {"Range": f"bytes={first}-{last}"})
    assert CONTENT[answer.begin : answer.end] == CONTENT[first : last + 1]


@given(st.text(alphabet="bytes=-0123456789, ", max_size=30))
@example("bytes=-")
@example("bytes=-5")
@example("bytes=0-1,3-4")
@example("bytes=" + "9" * 40 + "-")
@example("lines=1-2")
def test_any_range_is_a_part_of_the_file_or_ignored(text: str) -> None:
    answer = answer_for(ID, len(CONTENT), {"Range": text})
    assert 0 <= answer.begin <= answer.end <= len(CONTENT)


@pytest.mark.parametrize(
    ("asked", "status", "part"),
    [
        ({}, 200, (0, 50)),
        ({"Range": "bytes=10-19"}, 206, (10, 20)),
        ({"Range": "bytes=10-19", "If-Range": f'"{ID}"'}, 206, (10, 20)),
        ({"Range": "bytes=10-19", "If-Range": '"other"'}, 200, (0, 50)),
        ({"Range": "bytes=10-19", "If-Range": f'W/"{ID}"'}, 200, (0, 50)),
        ({"Range": "bytes=0-1,4-5"}, 200, (0, 50)),
        ({"Range": "bytes=50-"}, 416, (0, 0)),
        ({"Range": "bytes=-7"}, 200, (0, 50)),
    ],
)
def test_the_headers_of_a_request_choose_its_answer(
    asked: dict[str, str], status: int, part: tuple[int, int]
) -> None:
    answer = answer_for(ID, 50, asked)
    assert (answer.status, (answer.begin, answer.end)) == (status, part)
    if status < 400:
        assert answer.headers["ETag"] == f'"{ID}"'
        assert "immutable" in answer.headers["Cache-Control"]
    if status == HTTPStatus.PARTIAL_CONTENT:
        assert answer.headers["Content-Range"] == "bytes 10-19/50"
        assert answer.headers["Content-Length"] == "10"
    if status == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
        assert answer.headers["Content-Range"] == "bytes */50"


# Slots


def test_slots_are_limited_in_all_and_for_each_address_and_come_back() -> None:
    slots = Slots(limit=3, per_address=2)
    with slots.taken("a"), slots.taken("a"):
        with pytest.raises(BusyError), slots.taken("a"):
            pass
        with slots.taken("b"), pytest.raises(BusyError), slots.taken("c"):
            pass
    with slots.taken(""), slots.taken(""), slots.taken(""):
        pass


def test_first_uploads_at_once_share_the_folder_that_goes_with_the_relay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(20):
            folder = AvatarFolder("temporary")
            folder.prepare(10)
            with ThreadPoolExecutor(4) as pool:
                for number in range(4):
                    pool.submit(folder.keep, f"{number:064x}", b"x")
            assert len(list(tmp_path.glob("*"))) == 1
            assert len(list(tmp_path.glob("*/*.pica"))) == 4
            folder.close()
            assert list(tmp_path.glob("*")) == []
    finally:
        sys.setswitchinterval(interval_s)
