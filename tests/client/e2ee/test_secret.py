"""The file with the room secret, and the command that makes it."""

import sys
from pathlib import Path

import pytest

from pica_client.cli.machine import SecretOptions, secret
from pica_client.e2ee.secret import RoomSecret, load_secret, save_secret
from pica_client.errors import SealError

pytestmark = pytest.mark.unit


def test_a_secret_comes_back_from_its_file(tmp_path: Path) -> None:
    save_secret(tmp_path / "secret", RoomSecret(bytes(range(32))))
    assert load_secret(tmp_path / "secret").value == bytes(range(32))
    line = (tmp_path / "secret").read_text()
    for encoding in ("utf-16", "utf-8-sig"):  # as PowerShell and Notepad write it
        (tmp_path / encoding).write_text(line, encoding=encoding)
        assert load_secret(tmp_path / encoding).value == bytes(range(32))


@pytest.mark.skipif(sys.platform == "win32", reason="other rights")
def test_nobody_else_can_read_the_file_or_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    secret(SecretOptions(file=tmp_path / "secret"))
    assert (tmp_path / "secret").stat().st_mode & 0o777 == 0o600
    load_secret(tmp_path / "secret")
    assert capsys.readouterr().err.count("can read it") == 0
    (tmp_path / "secret").chmod(0o644)
    load_secret(tmp_path / "secret")
    assert capsys.readouterr().err.count("every user of this machine can read it") == 1


def test_every_secret_is_another_and_is_not_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = [secret(SecretOptions(file=tmp_path / name)) for name in "ab"]
    assert len({load_secret(tmp_path / name).value for name in "ab"}) == 2
    assert results[0] == {"file": str(tmp_path / "a")}
    shown = capsys.readouterr()
    line = (tmp_path / "a").read_text().strip()
    assert line.partition(":")[2] not in shown.out + shown.err
    assert "0x" in repr(load_secret(tmp_path / "a"))


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("mine")
    with pytest.raises(SealError, match="is there already") as raised:
        secret(SecretOptions(file=tmp_path / "secret"))
    assert raised.value.exit_code == 2
    assert (tmp_path / "secret").read_text() == "mine"


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SealError, match="no/secret: cannot be written: No such file"):
        secret(SecretOptions(file=tmp_path / "no" / "secret"))
    with pytest.raises(SealError, match="no/secret: cannot be read: No such file"):
        load_secret(tmp_path / "no" / "secret")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"correct horse battery staple",
        b"pica-secret-1:AAAA",
        b"pica-secret-2:" + b"A" * 43 + b"=",
        b"pica-secret-1:" + b"A" * 43 + b"==",
        b"A" * 43 + b"=",
        b"\xff\xfe" * 20,
        b"pica-secret-1:" + b"A" * 10_000,
    ],
)
def test_anything_else_is_refused_with_the_fix(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "secret").write_bytes(content)
    with pytest.raises(SealError, match="no room secret; make one with `pica secret FILE`"):
        load_secret(tmp_path / "secret")
