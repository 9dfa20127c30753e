"""The relay's log: lines of JSON or text, with numbers and ids instead of names and addresses.

A logging call gives a message that is always the same and fields: ids that the relay made, codes,
numbers. Room names, display names, addresses, tokens and payloads are no fields. Two rules hold for
what others have written: of an error only its type and where it happened is logged, and of other
libraries only that they said something. The JSON formatter is six lines; a library's would have
to be told to leave all of this out.

Strangers cause most lines, so there is a limit to how many a second they can cause. A thread writes
them: the reader of the log may stop reading, and that stops nothing but the log.
"""

import json
import logging
import os
import queue
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from threading import Thread
from typing import Any, Final, Literal, TextIO

from pica_server.limits import TokenBucket

Style = Literal["text", "json"]
Level = Literal["debug", "info", "warning", "error"]

OURS: Final = "pica_server"
LINES_PER_S: Final = 20.0
LINES_AT_ONCE: Final = 200.0
"""Lines below a warning, and of libraries; those left out are counted in the next one (chosen: 2 kB
a second)."""
MOST_WAITING: Final = 1000
"""Lines that may wait to be written; one more is dropped (chosen: 200 kB)."""
LAST_WORDS_S: Final = 1.0
"""How long the end of the process may wait until they are."""
MOST_FRAMES: Final = 12
"""Places of a traceback that are logged, from its end."""

_KNOWN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "spoken"}


@contextmanager
def logging_to(
    stream: TextIO, style: Style, level: Level, clock: Callable[[], float]
) -> Iterator[Counter[str]]:
    """Send all logs of the process from a level on to a stream for a while.

    Args:
        stream: Where to; no caller waits for it.
        clock: Seconds, for the limit of lines.

    Yields:
        How many lines were ``taken`` to be written, and ``dropped`` as too many waited.
    """
    handler = _Writer(stream)
    handler.setFormatter(JsonFormatter() if style == "json" else TextFormatter())
    least = logging.getLevelNamesMapping()[level.upper()]
    handler.addFilter(LineLimit(clock, least))
    root, ours = logging.getLogger(), logging.getLogger(OURS)
    before = ours.level
    root.addHandler(handler)
    ours.setLevel(min(least, logging.INFO))
    try:
        yield handler.counts
    finally:
        ours.setLevel(before)
        root.removeHandler(handler)
        handler.close()


class _Writer(logging.Handler):
    """Hands lines to a thread that writes them; drops those that find the queue full, and says in
    the next line that gets in how many those were."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()
        self._stream = stream
        self._num_unsaid = 0
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        # A daemon: one that is stuck in writing must not keep the process.
        self._thread = Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line."""
        if self._num_unsaid:
            record.dropped = self._num_unsaid
        try:
            self._lines.put_nowait(self.format(record) + "\n")
        except queue.Full:
            self._num_unsaid += 1
            self.counts["dropped"] += 1
        else:
            self._num_unsaid = 0
            self.counts["taken"] += 1

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


class LineLimit(logging.Filter):
    """Leaves out lines below a level and, when there are too many, those that are no warning of
    ours; these are counted."""

    def __init__(self, clock: Callable[[], float], least: int = logging.INFO) -> None:
        super().__init__()
        self._clock = clock
        self._least = least
        self._bucket = TokenBucket(LINES_PER_S, LINES_AT_ONCE, clock())
        self._left_out = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return True if a line may be written."""
        if not hasattr(record, "spoken"):
            if record.levelno < self._least:
                return False
            # What a library warns of may be a stranger's doing too: asyncio does of dead sockets.
            is_news = record.levelno >= logging.WARNING and _is_ours(record)
            if not is_news and not self._bucket.take(self._clock()):
                self._left_out += 1
                return False
        if self._left_out:
            record.left_out = self._left_out
            self._left_out = 0
        return True


class JsonFormatter(logging.Formatter):
    """One JSON object a line: ``time``, ``level``, ``event``, and the fields."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        head = {"time": _time(record), "level": record.levelname.lower(), "event": _event(record)}
        return json.dumps({**head, **_fields(record)}, ensure_ascii=True)


class TextFormatter(logging.Formatter):
    """Lines for people; what the command says to its user stands alone."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        spoken = getattr(record, "spoken", None)
        if spoken is not None:
            return str(spoken)
        words = [_time(record), record.levelname.lower(), _event(record)]
        return " ".join([*words, *(f"{name}={value}" for name, value in _fields(record).items())])


def say(logger: logging.Logger, event: str, spoken: str, **fields: Any) -> None:
    """Log something for the user of the command, whatever the level: a sentence, or in JSON an
    event."""
    logger.info(event, extra={"spoken": spoken, **fields})


def _is_ours(record: logging.LogRecord) -> bool:
    return record.name == OURS or record.name.startswith(f"{OURS}.")


def _time(record: logging.LogRecord) -> str:
    moment = datetime.fromtimestamp(record.created, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _event(record: logging.LogRecord) -> str:
    # The arguments of other libraries may be anything; the message before they are put in is not.
    return str(record.msg) if _is_ours(record) else f"message of {record.name}"


def _fields(record: logging.LogRecord) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    if _is_ours(record):
        fields = {name: value for name, value in vars(record).items() if name not in _KNOWN}
    if record.exc_info and record.exc_info[0] is not None:
        fields["error"] = record.exc_info[0].__name__
        frames = traceback.extract_tb(record.exc_info[2])[-MOST_FRAMES:]
        fields["where"] = [f"{Path(each.filename).name}:{each.lineno}" for each in frames]
    return fields
