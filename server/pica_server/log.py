"""The relay's log: lines of JSON or text, with numbers and ids instead of names and addresses.

A logging call gives a message that is always the same and fields: ids that the relay made, codes,
numbers. Room names, display names, addresses, tokens and payloads are no fields. Two rules hold for
what others have written: of an error only its type and where it happened is logged, and of other
libraries only that they said something.

Strangers cause most lines, so there is a limit to how many a second they can cause. A thread writes
them: the reader of the log may stop reading, and that stops nothing but the log.
"""

import json
import logging
import os
import queue
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Thread
from typing import Any, Final, Literal, TextIO

from pica_server.limits import TokenBucket

Style = Literal["text", "json"]

OURS: Final = "pica_server"
LINES_PER_S: Final = 20.0
LINES_AT_ONCE: Final = 200.0
"""Lines below a warning, and of libraries (chosen: 2 kB a second)."""
MOST_WAITING: Final = 1000
"""Lines that may wait to be written (chosen: 200 kB)."""
LAST_WORDS_S: Final = 1.0
"""How long the end of the process may wait until they are."""
MOST_FRAMES: Final = 12
"""Places of a traceback that are logged, from its end."""

_KNOWN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "spoken"}


@contextmanager
def logging_to(stream: TextIO, style: Style, clock: Callable[[], float]) -> Iterator[None]:
    """Send all logs of the process to a stream for a while; no caller waits for it.

    Args:
        clock: Seconds, for the limit of lines.
    """
    handler = _Handler(stream, style, clock)
    root, ours = logging.getLogger(), logging.getLogger(OURS)
    before = ours.level
    root.addHandler(handler)
    ours.setLevel(logging.INFO)
    try:
        yield
    finally:
        ours.setLevel(before)
        root.removeHandler(handler)
        handler.close()


class _Handler(logging.Handler):
    """Hands lines to a thread that writes them. Of those that are too many, and those that find the
    queue full, the next line that gets in says how many they were: ``left_out``."""

    def __init__(self, stream: TextIO, style: Style, clock: Callable[[], float]) -> None:
        super().__init__(logging.INFO)
        self._stream, self._style, self._clock = stream, style, clock
        self._bucket = TokenBucket(LINES_PER_S, LINES_AT_ONCE, clock())
        self._left_out = 0
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        # A daemon: one that is stuck in writing must not keep the process.
        self._thread = Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line."""
        # What a library warns of may be a stranger's doing: asyncio does of dead sockets.
        is_news = record.levelno >= logging.WARNING and _is_ours(record)
        if is_news or hasattr(record, "spoken") or self._bucket.take(self._clock()):
            if self._left_out:
                record.left_out = self._left_out
            with suppress(queue.Full):
                self._lines.put_nowait(self.format(record) + "\n")
                self._left_out = 0
                return
        self._left_out += 1

    def format(self, record: logging.LogRecord) -> str:
        """Return the line: one JSON object; or words for people, in which what the command says to
        its user stands alone."""
        fields = _fields(record)
        # The arguments of other libraries may be anything; the message before they are put in is
        # not.
        event = str(record.msg) if _is_ours(record) else f"message of {record.name}"
        moment = datetime.fromtimestamp(record.created, UTC)
        time = moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
        level = record.levelname.lower()
        if self._style == "json":
            return json.dumps({"time": time, "level": level, "event": event, **fields})
        if hasattr(record, "spoken"):
            return str(record.spoken)
        return " ".join([time, level, event, *(f"{key}={value}" for key, value in fields.items())])

    def close(self) -> None:
        """Wait a moment until all is written."""
        with suppress(queue.Full):
            self._lines.put_nowait(None)
            self._thread.join(LAST_WORDS_S)
        super().close()

    def _write_all(self) -> None:
        while (line := self._lines.get()) is not None:
            with suppress(OSError, ValueError):  # it is not read any more, or the disk is full
                self._write(line)

    def _write(self, line: str) -> None:
        try:
            # Not through the stream: its lock, held by a write that is stuck, ends Python badly.
            number = self._stream.fileno()
        except OSError:  # it is in memory
            self._stream.write(line)
            return
        data = line.encode()
        while data:
            data = data[os.write(number, data) :]


def say(logger: logging.Logger, event: str, spoken: str, **fields: Any) -> None:
    """Log something for the user of the command: a sentence, or in JSON an event."""
    logger.info(event, extra={"spoken": spoken, **fields})


def _is_ours(record: logging.LogRecord) -> bool:
    return record.name == OURS or record.name.startswith(f"{OURS}.")


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    if _is_ours(record):
        fields = {name: value for name, value in vars(record).items() if name not in _KNOWN}
    elif hasattr(record, "left_out"):
        fields = {"left_out": record.left_out}
    if record.exc_info and record.exc_info[0] is not None:
        fields["error"] = record.exc_info[0].__name__
        frames = traceback.extract_tb(record.exc_info[2])[-MOST_FRAMES:]
        fields["where"] = [f"{Path(each.filename).name}:{each.lineno}" for each in frames]
    return fields
