"""What end-to-end encryption costs: processor time and notes when somebody comes or goes.

    python scripts/seal_cost.py

Everybody's key exchange runs in this process, without sockets. For each size of a room: the room
is settled, one more comes, sends and goes; processor time is that of one participant on average,
the median of some rounds. Notes and their bytes are those of the whole room.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from helpers.sealed_room import Room  # noqa: E402


def turn(room: Room, size: int, move: Callable[[str], object]) -> dict[str, float]:
    """Let somebody come or go, and a moment pass; say what it cost."""
    said, began_s = len(room.whispers), time.process_time()
    move("late")
    room.run(2)
    spent_ms = (time.process_time() - began_s) * 1e3
    whispers = room.whispers[said:]
    num_bytes = sum(len(data) for _, _, data in whispers)
    return {"ms": spent_ms / size, "notes": len(whispers), "bytes": num_bytes}


def one_round(size: int) -> dict[str, float]:
    """Settle all but one; one more comes, and goes."""
    room = Room()
    for number in range(size - 1):
        room.join(f"p{number}")
    room.run(5)
    for name in list(room.members):
        room.send(name)
    joined = turn(room, size, room.join)
    frame = room.send("late", bytes(7))
    opened = [room.members[name].frames[-1].payload for name in room.members if name != "late"]
    assert opened == [bytes(7)] * (size - 1)
    left = turn(room, size - 1, room.leave)
    costs = {f"join_{key}": value for key, value in joined.items()}
    costs |= {f"leave_{key}": value for key, value in left.items()}
    return {**costs, "frame_bytes": len(frame.payload) - 7}


def main() -> None:
    """Read the command line, measure, print a JSON line for each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    for size in (2, 5, 16):
        rounds = [one_round(size) for _ in range(options.rounds)]
        medians = {key: statistics.median(each[key] for each in rounds) for key in rounds[0]}
        print(json.dumps({"people": size, **{k: round(v, 3) for k, v in medians.items()}}))


if __name__ == "__main__":
    main()
