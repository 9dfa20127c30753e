"""What it costs when somebody comes to an encrypted room or leaves it: processor time and bytes.

    PYTHONPATH=tests python -m helpers.seal_costs

Everybody's key exchange runs in this process, without sockets. Processor time is that of one
participant on average, messages and bytes are those of the whole room; medians of 15 rounds.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from helpers.sealed_room import Room


def turn(room: Room, size: int, move: Callable[[str], object]) -> tuple[float, int, int]:
    """Let somebody come or go, and a moment pass; return milliseconds, messages and bytes."""
    said, began_s = len(room.whispers), time.process_time()
    move("late")
    room.run(2)
    spent_ms = (time.process_time() - began_s) * 1e3
    whispers = room.whispers[said:]
    return spent_ms / size, len(whispers), sum(len(data) for _, _, data in whispers)


def one_round(size: int) -> tuple[float, ...]:
    """Settle all but one; one more comes, and goes."""
    room = Room()
    for number in range(size - 1):
        room.join(f"p{number}")
    room.run(5)
    for name in list(room.members):
        room.send(name)
    return turn(room, size, room.join) + turn(room, size - 1, room.leave)


def main() -> None:
    """Print a line of the table for each size of a room."""
    print("| people | join: ms | messages | bytes | leave: ms | messages | bytes |")
    print("|---|---|---|---|---|---|---|")
    for size in (2, 5, 16):
        rounds = zip(*(one_round(size) for _ in range(15)), strict=True)
        medians = [statistics.median(values) for values in rounds]
        cells = (
            f"{value:.2f}" if i % 3 == 0 else f"{value:,.0f}" for i, value in enumerate(medians)
        )
        print(f"| {size} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
