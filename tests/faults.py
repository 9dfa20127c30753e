"""What faults do to a call: a relay, three senders and a viewer, all real processes on loopback.

python tests/faults.py                          every fault, some five minutes
python tests/faults.py "relay paused" --json    those whose name begins so

Each fault gets a call of its own. A row says how many faces were alive at the end, how long after
the fault was over the last of them was back (a frame captured after it), the longest gap between
frames of one face, gaps that are still open included, and how old frames were at the end.
To add a fault, write a coroutine that does it and returns when it is over, under ``@fault``.
"""

import argparse
import asyncio
import itertools
import json
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pica_client.system import say
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined
from pica_protocol.session import ClientEvent
from pica_server.tokens import Admission, load_keys, mint, new_key_line
from simnet.peers import peer_in_room

NAMES = ("ada", "bob", "cleo")
CALM_S = 4.0
"""Before the fault."""
LONGEST_BACK_S = 25.0
"""A face that is not back by then is lost."""
SETTLED_S = 3.0
"""After all are back: the rest of the fault shows in the age of the frames."""


class Call:
    """The processes of one call: ``relay``, ``senders`` by name, ``viewer``, and perhaps a
    ``proxy`` between senders and relay."""

    proxy: subprocess.Popen[str] | None = None
    unread: socket.socket | None = None
    """The other end of the relay's log, if nobody reads it."""

    def __init__(self, fault: "Fault") -> None:
        self._fps = fault.fps
        self._processes: list[subprocess.Popen[str]] = []
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = int(free.getsockname()[1])
        self.url = url = f"ws://127.0.0.1:{self.port}"
        self.relay_arguments = fault.relay
        self._folder = tempfile.TemporaryDirectory()
        self.folder = Path(self._folder.name)
        self.tokens: dict[str, Path] = {}
        if fault.with_tokens:
            self.make_tokens()
        self.relay = self.start_relay()
        if fault.through_proxy:
            self.proxy = self.start([__file__, "--proxy", str(self.port)], stdout=subprocess.PIPE)
            assert self.proxy.stdout is not None
            url = self.proxy.stdout.readline().strip()
        self.senders = {name: self.start_sender(name, url) for name in NAMES}
        words = [__file__, "--watch", self.url]
        if self.tokens:
            words += ["--token", str(self.tokens["viewer"])]
        self.viewer = self.start(words, stdout=subprocess.PIPE)
        assert self.viewer.stdout is not None
        self.viewer.stdout.readline()  # when it has seen all of them

    def start(self, words: list[str], **options: Any) -> subprocess.Popen[str]:
        """Start a Python program that ends with the call."""
        process = subprocess.Popen([sys.executable, *words], text=True, **options)
        self._processes.append(process)
        return process

    def make_tokens(self) -> None:
        """Make a key file for the relay and a token for each client."""
        keys = self.folder / "keys"
        keys.write_text(new_key_line())
        ring, now = load_keys(keys), time.time()
        for name in (*NAMES, "viewer"):
            admission = Admission(identity=name, avatars=("*",))
            self.tokens[name] = self.folder / name
            token = mint(ring, "lobby", admission, now=now, lasts_s=900)
            self.tokens[name].write_text(token)
        self.relay_arguments += ("--keys", str(keys))

    def start_relay(self, **options: Any) -> subprocess.Popen[str]:
        """Start the relay, or start it again at the same address, and wait until it listens."""
        words = ["-m", "pica_command", "relay", "--port", str(self.port), "--avatar-store", "none"]
        options = {"stderr": subprocess.DEVNULL, **options}
        self.relay = self.start([*words, *self.relay_arguments], **options)
        for _ in range(500):
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return self.relay
            time.sleep(0.02)
        raise SystemExit("the relay does not listen")

    async def restart_relay(self, away_s: float, *arguments: str, **options: Any) -> None:
        """Kill the relay and start it a while later, once with further arguments."""
        self.relay.kill()
        self.relay.wait()
        await asyncio.sleep(away_s)
        before, self.relay_arguments = self.relay_arguments, (*self.relay_arguments, *arguments)
        await asyncio.to_thread(self.start_relay, **options)
        self.relay_arguments = before

    def start_sender(self, name: str, url: str) -> subprocess.Popen[str]:
        """Start a sender."""
        words = ["-m", "pica_command", "send", "--url", url, "--name", name, "--wait"]
        words += ["--fps", str(self._fps)]
        if self.tokens:
            words += ["--token-file", str(self.tokens[name])]
        return self.start(words, stderr=subprocess.DEVNULL)

    def stop(self) -> dict[str, list[tuple[float, float]]]:
        """End everything; return when each face's frames came and were captured."""
        for process in self._processes:
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
        self.viewer.terminate()
        seen, _ = self.viewer.communicate(timeout=10)
        for process in self._processes:
            process.kill()
            process.wait()
        self._folder.cleanup()
        return dict(json.loads(seen))


Hurt = Callable[[Call], Awaitable[None]]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that goes wrong, and what the call needs for it."""

    hurt: Hurt
    fps: float = 30.0
    """Frames a second of each sender."""
    through_proxy: bool = False
    """Whether the senders reach the relay through ``call.proxy``."""
    relay: tuple[str, ...] = ()
    """Further arguments of the relay."""
    with_tokens: bool = False
    """Whether the relay wants tokens."""


FAULTS: dict[str, Fault] = {}


def fault(name: str, **needs: Any) -> Callable[[Hurt], Hurt]:
    """Give a fault a row of the table; `needs` are the fields of `Fault`."""

    def enter(hurt: Hurt) -> Hurt:
        FAULTS[name] = Fault(hurt=hurt, **needs)
        return hurt

    return enter


async def pause(processes: list[subprocess.Popen[str]], seconds: float) -> None:
    """Stop processes for a while without ending them."""
    for process in processes:
        process.send_signal(signal.SIGSTOP)
    await asyncio.sleep(seconds)
    for process in processes:
        process.send_signal(signal.SIGCONT)


for _seconds, _fps in ((13.0, 30.0), (7.0, 120.0)):

    @fault(f"relay paused {_seconds:g} s at {_fps:g} fps", fps=_fps)
    async def _relay_paused(call: Call, seconds: float = _seconds) -> None:
        await pause([call.relay], seconds)


@fault("proxy stalls 11.5 s", through_proxy=True)
async def _proxy_stalls(call: Call) -> None:
    assert call.proxy is not None
    await pause([call.proxy], 11.5)


@fault("one sender paused 20 s")
async def _sender_paused(call: Call) -> None:
    await pause([call.senders["ada"]], 20.0)


@fault("viewer paused 20 s")
async def _viewer_paused(call: Call) -> None:
    await pause([call.viewer], 20.0)


@fault("everything paused 25 s", through_proxy=True)
async def _all_paused(call: Call) -> None:
    await pause([call.relay, *call.senders.values(), call.viewer], 25.0)


@fault("relay killed, back after 1.5 s")
async def _relay_killed(call: Call) -> None:
    await call.restart_relay(1.5)


@fault("one sender killed, started again after 1 s")
async def _sender_killed(call: Call) -> None:
    call.senders["ada"].kill()
    await asyncio.sleep(1.0)
    call.senders["ada"] = call.start_sender("ada", call.url)


@fault("relay's log is not read, 300 strangers write into it")
async def _log_not_read(call: Call) -> None:
    unread, stderr = socket.socketpair()
    stderr.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2048)
    call.unread = unread  # else it would be closed
    await call.restart_relay(0.0, "--limits.joins-burst", "1000", stderr=stderr)
    for _ in range(300):
        async with peer_in_room(call.url, "Stranger", room="elsewhere"):
            pass


@fault("way lost without a word", through_proxy=True)
@fault(
    "way lost, the address is full",
    through_proxy=True,
    relay=("--limits.connections-per-address", "3", "--trusted-proxies", "127.0.0.1"),
)
async def _path_lost(call: Call) -> None:
    """Let the proxy swallow what its connections carry while new ones get through: so a lost NAT
    table or a new address looks to a program."""
    assert call.proxy is not None
    call.proxy.send_signal(signal.SIGUSR1)


@fault("wrong keys for 2 s", with_tokens=True)
async def _wrong_keys(call: Call) -> None:
    wrong = call.folder / "wrong"
    wrong.write_text(new_key_line())
    right, call.relay_arguments = call.relay_arguments, ("--keys", str(wrong))
    await call.restart_relay(0.5)
    await asyncio.sleep(2.0)
    call.relay_arguments = right
    await call.restart_relay(0.0)


def figures(
    seen: dict[str, list[tuple[float, float]]], begin_s: float, over_s: float, end_s: float
) -> dict[str, Any]:
    """Make a row of when frames came and were captured."""
    back_s, gaps_s, ages_s, num_alive = [], [], [], 0
    for name in NAMES:
        frames = [each for each in seen.get(name, []) if each[0] <= end_s]
        fresh = [arrival_s for arrival_s, captured_s in frames if captured_s >= over_s]
        ages_s += [a - c for a, c in frames if a > end_s - 1.0]
        num_alive += bool(fresh) and fresh[-1] > end_s - 2.0
        back_s.append(fresh[0] - over_s if fresh else None)
        marks = [begin_s, *(a for a, _ in frames if a > begin_s), end_s]
        gaps_s.append(max(b - a for a, b in itertools.pairwise(marks)))
    known = [each for each in back_s if each is not None]
    return {
        "survived": f"{num_alive} of {len(NAMES)}",
        "back_after_s": round(max(known), 2) if len(known) == len(NAMES) else None,
        "longest_gap_s": round(max(gaps_s), 2),
        "age_ms_at_end": round(statistics.median(ages_s) * 1000, 1) if ages_s else None,
    }


async def run(name: str) -> dict[str, Any]:
    """Inject one fault into one call; return its row."""
    fault = FAULTS[name]
    call = await asyncio.to_thread(Call, fault)
    try:
        await asyncio.sleep(CALM_S)
        begin_s = time.monotonic()
        await fault.hurt(call)
        over_s = time.monotonic()
        await asyncio.sleep(min(SETTLED_S + max(over_s - begin_s, 8.0), LONGEST_BACK_S))
        end_s = time.monotonic()
    finally:
        seen = await asyncio.to_thread(call.stop)
    return {"fault": name, **figures(seen, begin_s, over_s, end_s)}


def watch(url: str, token_file: Path | None) -> None:
    """Look on until told to stop, then print when each face's frames came and were captured."""
    seen: dict[str, list[tuple[float, float]]] = defaultdict(list)
    names: dict[int, str] = {}
    is_complete = False

    def on_event(event: ClientEvent, now: float) -> None:
        nonlocal is_complete
        peers: tuple[Peer, ...] = ()
        if isinstance(event, Frame):
            seen[names[event.stream]].append((now, event.captured_us / 1e6))
            if len(seen) == len(NAMES) and not is_complete:
                is_complete = True
                print("all are here", flush=True)
        elif isinstance(event, Joined):
            names.clear()
            peers = event.peers
        elif isinstance(event, PeerJoined):
            peers = (event.peer,)
        names.update({track.stream: peer.name for peer in peers for track in peer.tracks})

    async def look() -> None:
        config = LinkConfig(url=url, name="viewer", connect_timeout_s=None, token_file=token_file)
        link = Link(config, on_event=on_event)
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, link.leave)
        await link.run()

    asyncio.run(look())
    print(json.dumps(seen))


def proxy(port: int) -> None:
    """Forward bytes to a port of this machine until killed, and print the address. A SIGUSR1 makes
    it swallow what the present connections carry."""
    age = 0

    async def pump(
        reader: asyncio.StreamReader, writer: asyncio.StreamWriter, head: bytes = b""
    ) -> None:
        born = age
        with suppress(OSError):
            while data := await reader.read(65_536):
                if born == age:
                    writer.write(data.replace(b"\r\n", b"\r\n" + head, 1))
                    head = b""
                    await writer.drain()
        if born == age:
            writer.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, to = await asyncio.open_connection("127.0.0.1", port)
        head = b"X-Forwarded-For: 192.0.2.1\r\n"
        await asyncio.gather(pump(reader, to, head), pump(back, writer))

    def grow_old() -> None:
        nonlocal age
        age += 1

    async def listen() -> None:
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, grow_old)
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        print(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", flush=True)
        await server.serve_forever()

    asyncio.run(listen())


def main() -> None:
    """Read the command line, run, print the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="beginnings of the faults' names; all without")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON at the end")
    parser.add_argument("--watch", help=argparse.SUPPRESS)
    parser.add_argument("--token", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--proxy", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.watch:
        return watch(options.watch, options.token)
    if options.proxy:
        return proxy(options.proxy)
    chosen = [n for n in FAULTS if not options.names or n.startswith(tuple(options.names))]
    if not chosen:
        parser.error(f"no fault begins so; known are: {', '.join(FAULTS)}")
    rows = []
    for name in chosen:
        rows.append(asyncio.run(run(name)))
        say("  ".join(f"{key} {value}" for key, value in rows[-1].items()))
    if options.json:
        print(json.dumps({"faults": rows}))


if __name__ == "__main__":
    main()
