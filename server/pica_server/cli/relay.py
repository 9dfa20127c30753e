"""``pica relay``: run a relay until it is told to stop."""

import asyncio
import gc
import io
import logging
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self

import tyro

from pica_server.config.relay import RelayConfig
from pica_server.config.settings import (
    ELSEWHERE,
    Effective,
    as_plain,
    as_toml,
    one_line,
    read_options,
    without_user,
)
from pica_server.errors import ConfigurationError, ListenError
from pica_server.ops.certificate import Certificate
from pica_server.ops.log import Level, Style, logging_to, say
from pica_server.relay import Relay
from pica_server.store.store import AvatarStore

_logger = logging.getLogger(__name__)

ENVIRONMENT_PREFIX = "PICA_RELAY_"
CERTIFICATE_PERIOD_S = 2.0
"""Between two looks at the files of the certificate, see below (chosen: two stat calls)."""
CERTIFICATE_SETTLES_S = 0.5
"""Between the first change of a file and reading both (chosen)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RelayOptions:
    """Options of ``pica relay``."""

    config: Annotated[RelayConfig, tyro.conf.arg(name="")] = field(default_factory=RelayConfig)
    """Where to listen, and the limits."""
    ready_file: Path | None = None
    """Write the URL into this file once the relay listens, and remove it at the end."""
    log: Style = "text"
    """How to log to stderr: text, or json, an object a line. Neither holds names, addresses or
    payloads."""
    log_level: Level = "info"
    """The least that is logged; debug tells of connections that were not let in."""
    config_file: Annotated[Path | None, tyro.conf.arg(name="config"), ELSEWHERE] = None
    """Read settings from this TOML file. Flags go before PICA_RELAY_... in the environment, and
    that before the file; see docs/operating.md."""
    print_config: Annotated[bool, ELSEWHERE] = False
    """Check the settings, print all of them as TOML with where each comes from, and stop."""
    effective: Annotated[tuple[Effective, ...], tyro.conf.Suppress, ELSEWHERE] = ()

    @classmethod
    def parse(cls, words: Sequence[str], *, prog: str, description: str) -> Self:
        """Read the command line, the environment and the file.

        Raises:
            ConfigurationError: A setting that cannot work; one line that says where it stands.
        """

        def read_words(defaults: Self) -> Self:
            said = io.StringIO()
            try:
                with redirect_stderr(said):
                    return tyro.cli(
                        cls, prog=prog, args=list(words), description=description, default=defaults
                    )
            except SystemExit as end:
                if end.code != 2:
                    raise  # help was asked for
                raise ConfigurationError(one_line(said.getvalue())) from None

        options, effective = read_options(
            cls, read_words, words, os.environ, prefix=ENVIRONMENT_PREFIX
        )
        return replace(options, effective=tuple(effective))


def relay(options: RelayOptions) -> dict[str, Any]:
    """Run the relay: forwards between the peers of a room, until SIGINT or SIGTERM.

    SIGTERM sends everybody away first, see --drain-s; SIGINT, or another SIGTERM, ends at once. The
    first line on stderr says where it listens.

    Returns:
        Its settings with --print-config, else its statistics at the end; ``forward_ms`` holds
        percentiles of the forwarding latency.

    Raises:
        ConfigurationError: The certificate cannot be used.
        ListenError: The address or the ready file cannot be had.
        KeyFileError: The key file cannot be used.
        StoreError: The avatar store cannot be used.
    """
    if options.print_config:
        print(as_toml(options.effective), end="")
        return as_plain(options.effective)
    with asyncio.Runner(loop_factory=_loop_factory(options)) as runner:
        return runner.run(_run(options))


def _loop_factory(options: RelayOptions) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Choose uvloop where it can be had: a quarter less processor time (docs/results/relay.md).

    With TLS the standard loop stays: in uvloop nothing bounds what is written ahead of a slow
    reader, see `pica_server.net.socket.bound_tls_buffer`.
    """
    if sys.platform == "win32" or options.config.tls_cert is not None:
        return None
    import uvloop

    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory


async def _run(options: RelayOptions) -> dict[str, Any]:
    log = logging_to(sys.stderr, options.log, options.log_level, time.monotonic)
    with log, _signals() as signals, ExitStack() as stack:
        async with Relay(options.config) as server:
            stack.enter_context(_certificate_kept_fresh(server.certificate))
            url = server.url
            _spare_the_collector()
            with _ready_file(options.ready_file, url):
                _say("listening", f"listening on {url}", url=url)
                _say_what_is_open(options.config, server.store)
                first = await signals.get()
            if first == signal.SIGTERM and options.config.drain_s > 0:
                num_open = server.hub.num_connections
                _say("draining", f"draining, {num_open} connections to send away", open=num_open)
                await _unless(signals.get(), server.drain())
                server.cut()
            num_open = server.hub.num_connections
            _say("stopping", f"stopping, {num_open} connections to close", open=num_open)
    return {"url": url, **server.stats()}


def _say_what_is_open(config: RelayConfig, store: AvatarStore | None) -> None:
    if config.insecure:
        _say("insecure", "INSECURE: anybody who reaches this port may join any room")
    elif config.keys is None:
        _say("development", "DEVELOPMENT: no --keys, anybody on this machine may join any room")
    if store is not None:
        how = "all that receivers check" if store.checks_fully else "its layout"
        place, num_avatars = without_user(config.avatar_store), store.num_avatars
        _say(
            "avatar store",
            f"avatar store {place}: {num_avatars} avatars; of an upload is checked: {how}",
            avatars=num_avatars,
            checks_fully=store.checks_fully,
        )


def _spare_the_collector() -> None:
    """Let the garbage collector never again look at what was loaded to get here.

    It stops everything for as long as it looks: beside ten thousand connects a minute 40 to 120 ms
    at a time, with this 20 to 70 ms and half as often (measured).
    """
    gc.collect()
    gc.freeze()


@contextmanager
def _certificate_kept_fresh(certificate: Certificate | None) -> Iterator[None]:
    """Read the certificate again on SIGHUP, and when its files have changed."""
    if certificate is None:
        yield
        return

    def reload() -> None:
        try:
            certificate.reload()
        except ConfigurationError as error:
            _say("certificate refused", f"the old certificate stays: {error}", why=str(error))
        else:
            _say("certificate read", "read the certificate again")

    async def look() -> None:
        while True:
            await asyncio.sleep(CERTIFICATE_PERIOD_S)
            if certificate.has_changed():
                # Both files are written one after the other; the pair is there a moment later.
                await asyncio.sleep(CERTIFICATE_SETTLES_S)
                reload()

    loop = asyncio.get_running_loop()
    looking = loop.create_task(look())
    before = None
    if hasattr(signal, "SIGHUP"):
        before = signal.signal(signal.SIGHUP, lambda *_: loop.call_soon_threadsafe(reload))
    try:
        yield
    finally:
        looking.cancel()
        if hasattr(signal, "SIGHUP"):
            signal.signal(signal.SIGHUP, before)


async def _unless(interruption: Awaitable[object], work: Awaitable[object]) -> None:
    """Do some work until it is done or something else happens."""
    tasks = {asyncio.ensure_future(interruption), asyncio.ensure_future(work)}
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@contextmanager
def _signals() -> Iterator[asyncio.Queue[int]]:
    """Queue the signals to stop that come; two say all there is to say, more are dropped."""
    # signal.signal and not loop.add_signal_handler: the latter is missing on Windows.
    loop = asyncio.get_running_loop()
    queue: asyncio.Queue[int] = asyncio.Queue(maxsize=2)

    def note(number: int) -> None:
        if not queue.full():
            queue.put_nowait(number)

    names = (signal.SIGINT, signal.SIGTERM)
    before = [
        signal.signal(name, lambda number, _: loop.call_soon_threadsafe(note, number))
        for name in names
    ]
    try:
        yield queue
    finally:
        for name, handler in zip(names, before, strict=True):
            signal.signal(name, handler)


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
        raise ListenError(f"cannot write --ready-file {path}: {error.strerror}") from error
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _say(event: str, spoken: str, **fields: Any) -> None:
    say(_logger, event, spoken, **fields)
