"""Encryption between processes: sender and receiver share a file and a relay, and nothing else."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("cryptography", reason="needs the extra seal")

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar
from pica_client.call.call import Call
from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.local_call.processes import Children
from pica_client.transport.config import LinkConfig
from pica_client.transport.endpoints import Receiver
from pica_core.avatar.file import avatar_id, save_avatar

pytestmark = pytest.mark.realtime

PATIENCE_S = 30.0
"""Nothing here should take this long; a loaded machine may."""
POLL_S = 0.02
TOY = make_toy_avatar()


@pytest.fixture
def children() -> Iterator[Children]:
    with Children() as group:
        yield group


def wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s"
        time.sleep(POLL_S)


def test_a_sender_is_read_by_another_process_with_the_secret_only(
    children: Children, tmp_path: Path
) -> None:
    avatar, secret = tmp_path / "toy.pica", tmp_path / "secret"
    save_avatar(avatar, TOY)
    save_secret(secret, RoomSecret.new())
    _, url = children.start_relay()
    sender = children.start(
        "sender",
        *("send", "--url", url, "--room", "r", "--avatar", str(avatar), "--wait"),
        *("--secret-file", str(secret)),
    )
    member, stranger = (Call(LoadedAvatars({avatar_id(avatar): TOY})) for _ in range(2))
    inside = LinkConfig(url=url, room="r", name="member", secret_file=secret)
    outside = LinkConfig(url=url, room="r", name="stranger")
    with Receiver(inside, member) as receiver, Receiver(outside, stranger):
        wait_until(lambda: member.num_live == 1, "the face is seen")
        wait_until(lambda: receiver.stats(time.monotonic())["seal"]["opened"] > 20, "it goes on")
        notes = stranger.room(time.monotonic()).notes
        assert set(notes.values()) >= {"encrypted: the room's secret is needed"}
    assert stranger.num_live == 0
    assert receiver.stats(time.monotonic())["seal"]["forged"] == 0
    sender.let_go()
    wait_until(lambda: sender.exit_code is not None, "the sender ends")
    assert sender.result()["seal"]["sealed"] > 20


def test_a_secret_that_is_none_ends_with_two(tmp_path: Path) -> None:
    avatar = tmp_path / "toy.pica"
    save_avatar(avatar, TOY)
    command = [sys.executable, "-m", "pica_command", "send", "--secret-file", "nowhere"]
    command += ["--avatar", str(avatar)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "nowhere: cannot be read: No such file" in done.stderr.strip().splitlines()[-1]
    assert "Traceback" not in done.stderr
