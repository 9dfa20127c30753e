"""The store's pure parts: the layout of a file, ranges of it, turns and slots."""

import json
import struct
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pica_core.avatar import file as avatar_file
from pica_core.avatar.shipped import shipped_avatar_files
from pica_server.config.relay import StoreConfig
from pica_server.errors import BusyError, ConfigurationError, UnfitFileError
from pica_server.store import check as store_check
from pica_server.store.check import StructureCheck
from pica_server.store.downloads import answer_for
from pica_server.store.folder import AvatarFolder
from pica_server.store.store import Slots

pytestmark = pytest.mark.unit

ID = "ab" * 32


def file_of(header: object, data: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def tensor(begin: int, end: int, shape: list[int], dtype: str = "U8") -> dict[str, object]:
    return {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}


def header(**tensors: object) -> dict[str, object]:
    return {"__metadata__": {"pica": "{}"}, **tensors}


def check(data: bytes, size: int | None = None) -> None:
    structure = StructureCheck(len(data) if size is None else size)
    structure.receive(data)
    structure.finish()


GOOD = file_of(header(a=tensor(0, 6, [2, 3]), b=tensor(6, 14, [2], "F32")), bytes(14))


@given(st.lists(st.integers(0, len(GOOD)), max_size=5))
def test_a_good_layout_is_found_good_in_whatever_pieces_it_comes(cuts: list[int]) -> None:
    structure = StructureCheck(len(GOOD))
    edges = [0, *sorted(cuts), len(GOOD)]
    for begin, end in pairwise(edges):
        structure.receive(GOOD[begin:end])
    structure.finish()
    assert structure.is_done


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "ends within its header"),
        (GOOD[:30], "header would have"),
        (b"\xff" * 100, "header would have"),
        (struct.pack("<Q", 2**18 + 1) + bytes(2**19), "header would have 262145 bytes"),
        (b"\x80\x04\x95" + b"pickle" * 100, "header would have"),
        (file_of(b"[" * 100_000), "not valid JSON"),
        (file_of(b'{"a": NaN}'), "not valid JSON"),
        (file_of(b'{"a": 1, "a": 2}'), "not valid JSON"),
        (file_of(b"\xff\xfe{}"), "not valid JSON"),
        (file_of([1]), "no JSON object"),
        (file_of({}), "no manifest"),
        (file_of({"a": tensor(0, 1, [1])}, b"x"), "no manifest"),
        (file_of(header()), "0 tensors"),
        (file_of(header(a=1)), "no JSON object"),
        (file_of(header(a=tensor(0, 8, [1], "F64")), bytes(8)), "is of type 'F64'"),
        (file_of(header(a=tensor(0, 4, [-4])), bytes(4)), "no proper shape"),
        (file_of(header(a=tensor(0, 1, [True])), bytes(1)), "no proper shape"),
        (file_of(header(a=tensor(0, 1, [1] * 9)), bytes(1)), "no proper shape"),
        (file_of(header(a=tensor(0, 1, [2**63])), bytes(1)), "no proper shape"),
        (file_of(header(a=tensor(-1, 0, [1])), bytes(1)), "no proper place"),
        (file_of(header(a=tensor(0, 4, [5])), bytes(4)), "size of its shape"),
        (file_of(header(a=tensor(0, 4, [4]), b=tensor(2, 6, [4])), bytes(6)), "overlap"),
        (file_of(header(a=tensor(0, 4, [4]), b=tensor(5, 6, [1])), bytes(6)), "leave a hole"),
        (file_of(header(a=tensor(0, 4, [4])), bytes(5)), "take 4 bytes, 5 are there"),
        (file_of(header(a=tensor(0, 4, [4])), bytes(3)), "take 4 bytes, 3 are there"),
        (file_of(header(**{f"t{i}": tensor(i, i + 1, [1]) for i in range(1025)})), "1025 tensors"),
    ],
)
def test_what_is_no_avatar_file_is_refused_with_a_reason(data: bytes, words: str) -> None:
    with pytest.raises(UnfitFileError, match=words):
        check(data)


def test_a_file_is_refused_as_soon_as_its_header_is_there() -> None:
    data = file_of(header(a=tensor(0, 10**7, [10**7])))
    check(data, size=len(data) + 10**7)
    with pytest.raises(UnfitFileError, match="are there"):
        check(data, size=len(data) + 10**7 + 1)


@given(st.binary(max_size=400))
@example(GOOD)
def test_any_bytes_pass_or_are_refused(data: bytes) -> None:
    try:
        check(data)
    except UnfitFileError:
        assert data != GOOD


@pytest.mark.parametrize("path", shipped_avatar_files(), ids=lambda path: path.stem)
def test_the_avatars_that_ship_pass(path: Path) -> None:
    check(path.read_bytes())


def test_the_limits_are_those_of_receivers() -> None:
    assert store_check.MAX_HEADER_BYTES == avatar_file.MAX_HEADER_BYTES
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


@pytest.mark.parametrize(
    "field",
    ["quota_bytes", "largest_bytes", "max_avatars", "bytes_per_s", "uploads", "downloads"],
)
def test_a_limit_out_of_range_is_refused_by_name(field: str) -> None:
    option = "--store." + field.replace("_", "-")
    with pytest.raises(ConfigurationError, match=f"{option} must be in .*, got 0"):
        StoreConfig(**{field: 0})


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
