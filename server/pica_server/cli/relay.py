"""`pica relay`: run a relay until it is told to stop."""

import asyncio
import gc
import logging
import os
import signal
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pica_server.config import ConfigurationError, RelayConfig
from pica_server.log import Style, logging_to, say

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayOptions:
    """Options of `pica relay`."""

    config: Annotated[RelayConfig, Parameter(name="*")] = field(default_factory=RelayConfig)
    """Where to listen, and the limits."""
    ready_file: Path | None = None
    """Write the URL into this file once the relay listens, and remove it at the end."""
    log: Style = "text"
    """How to log to stderr: text, or json, an object a line. Neither holds names, addresses or
    payloads."""


def relay(options: RelayOptions) -> dict[str, Any]:
    """Run a relay: it forwards between the people of a room, until SIGINT or SIGTERM.

    SIGTERM sends everybody away first, see --drain-s; SIGINT, or another SIGTERM, ends at once. The
    first line on stderr says where it listens.

    Returns:
        Its counters at the end.

    Raises:
        ConfigurationError: The address, the certificate, the key file, the ready file or the avatar
            store cannot be used.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # until `_run` listens to it
    with asyncio.Runner(loop_factory=_loop_factory(options)) as runner:
        return runner.run(_run(options))


def _loop_factory(options: RelayOptions) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Choose uvloop where it can be had: a quarter less processor time (docs/results.md).

    With TLS the standard loop stays: in uvloop nothing bounds what is written ahead of a slow
    reader, see `pica_protocol.limits`.
    """
    if sys.platform == "win32" or options.config.tls_cert is not None:
        return None
    import uvloop

    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory


async def _run(options: RelayOptions) -> dict[str, Any]:
    with _signals_to_stop() as signals, logging_to(sys.stderr, options.log, time.monotonic):
        from pica_server.relay import Relay  # `pica relay --help` does without it

        async with Relay(options.config, processor_s=time.process_time) as server:
            url = server.url
            _spare_the_collector()
            with _ready_file(options.ready_file, url):
                _say("listening", f"listening on {url}", url=url)
                _say_what_is_open(options.config)
                first = await signals.get()
            if first == signal.SIGTERM and options.config.drain_s > 0:
                num_open = server.hub.num_connections
                _say("draining", f"draining, {num_open} connections to send away", open=num_open)
                tasks = [asyncio.create_task(each) for each in (server.drain(), signals.get())]
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                server.cut()
            num_open = server.hub.num_connections
            _say("stopping", f"stopping, {num_open} connections to close", open=num_open)
        stats = server.stats()
        _say(
            "stopped",
            f"forwarded {stats['frames_out']} frames ({stats['bytes_out']} bytes) "
            f"for {stats['joins']} joins; {sum(stats['dropped'].values())} frames dropped",
            **{name: stats[name] for name in ("joins", "frames_in", "frames_out", "bytes_out")},
        )
    return {"url": url, **stats}


def _say_what_is_open(config: RelayConfig) -> None:
    if config.insecure:
        _say("insecure", "INSECURE: anybody who reaches this port may join any room")
    elif config.keys is None:
        _say("development", "DEVELOPMENT: no --keys, anybody on this machine may join any room")
    elif os.name == "posix" and config.keys.stat().st_mode & stat.S_IROTH:
        _say("keys open", "anybody on this machine can read the key file: chmod 600 it")


def _spare_the_collector() -> None:
    """Let the garbage collector never again look at what was loaded to get here.

    It stops everything for as long as it looks: beside ten thousand connects a minute 40 to 120 ms
    at a time, with this 20 to 70 ms and half as often (measured).
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)  # a turn of a full core makes more objects than the usual 700


@contextmanager
def _signals_to_stop() -> Iterator["asyncio.Queue[int]"]:
    """Yield a queue that gets each signal to stop; what comes after the block is ignored, and does
    not cost the result."""
    loop, came = asyncio.get_running_loop(), asyncio.Queue[int]()

    def note(number: int, _: object) -> None:
        loop.call_soon_threadsafe(came.put_nowait, number)

    # signal.signal and not loop.add_signal_handler: the latter is missing on Windows.
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, note)
    try:
        yield came
    finally:
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, signal.SIG_IGN)


@contextmanager
def _ready_file(path: Path | None, url: str) -> Iterator[None]:
    if path is None:
        yield
        return
    unfinished = path.with_name(f"{path.name}.part")
    try:
        unfinished.write_text(f"{url}\n")
        os.replace(unfinished, path)
    except OSError as error:
        raise ConfigurationError(f"cannot write --ready-file {path}: {error.strerror}") from error
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _say(event: str, spoken: str, **fields: Any) -> None:
    say(_logger, event, spoken, **fields)
