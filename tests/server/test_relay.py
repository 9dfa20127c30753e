"""The real relay and real websockets on a virtual clock."""

import asyncio
import os
import select
import signal
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin, Subprotocol

from pica_client.errors import RelayUnreachableError
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import CloseCode
from pica_protocol.messages import PeerLeft
from pica_protocol.session import Closed, State
from pica_server.config import LimitsConfig, RelayConfig
from pica_server.net.pump import LONGEST_WAIT_S
from pica_server.net.socket import RelaySocket
from pica_server.relay import READ_AGAIN_S, Relay
from pica_server.room.connections import LATE_S
from pica_server.tokens import ANY_ROOM, Admission, load_keys, mint, new_key_line
from simnet.clock import current_network, in_virtual_time
from simnet.network import Wire
from simnet.peers import FACE, now, open_websocket, peer_in_room
from simnet.relays import RelayProcess, start_relay

pytestmark = pytest.mark.call

URL = "ws://relay:8765"
PICA = [Subprotocol(SUBPROTOCOL)]


@in_virtual_time
async def test_a_silent_peer_is_found_out_within_two_pings_and_the_closing_time() -> None:
    config = RelayConfig(ping_interval_s=10, close_timeout_s=2)
    async with (
        Relay(config),
        peer_in_room(URL, "Ada") as ada,
        peer_in_room("ws://train:8765", "Bob") as bob,
    ):
        current_network().cut("train")
        start = now()
        await ada.until(PeerLeft)
        assert now() - start == pytest.approx(22, abs=0.01)
        bob.websocket.transport.abort()


@in_virtual_time
async def test_a_slow_reader_gets_fewer_but_fresh_frames_and_costs_nobody_else_anything() -> None:
    network = current_network()
    network.route("modem", down=Wire(rate_bps=16_000, queue_bytes=2048))
    async with (
        Relay(RelayConfig()) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room("ws://modem:8765", "Slow", tracks=()) as slow,
        peer_in_room(URL, "Fast", tracks=()) as fast,
    ):
        await ada.publish(num_frames=600, fps=30, num_bytes=250)  # 64 kbit/s and headers
        await asyncio.sleep(10)
        assert len(fast.arrivals) == 600
        assert max(fast.delays_s) < 0.001
        assert 100 < len(slow.arrivals) < 200
        # What the buffers hold (2 kB in the network, 4 kB in the transport) takes 3 s on this line.
        assert max(slow.delays_s) < 3.5
        sequences = [frame.sequence for _, frame in slow.arrivals]
        assert sequences == sorted(set(sequences))
        assert sequences[-1] == 599
        stats = relay.stats()
        assert stats["dropped"]["replaced"] == 600 - len(slow.arrivals)


@in_virtual_time
async def test_messages_to_a_receiver_stay_short_for_as_long_as_it_is_slow() -> None:
    current_network().route("modem", down=Wire(rate_bps=16_000, queue_bytes=2048))
    async with (
        Relay(RelayConfig()),
        peer_in_room(URL, "Ada", tracks=(FACE,) * 4) as ada,
        peer_in_room("ws://modem:8765", "Slow", tracks=()) as slow,
    ):
        for number in range(1800):
            await ada.send_frame(bytes(250), track=number % 4)
            await asyncio.sleep(0.01)
        together = Counter(at for at, _ in slow.arrivals)
        assert set(together.values()) == {1}  # two of them are more than SLOW_MESSAGE_BYTES


@in_virtual_time
async def test_nothing_is_given_to_a_line_that_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    until_s = now() + 2.0
    monkeypatch.setattr(RelaySocket, "_is_line_full", lambda self: 1.0 < until_s - now() < 1.9)
    async with (
        Relay(RelayConfig()) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob", tracks=()) as bob,
    ):
        await ada.publish(num_frames=90, fps=30, num_bytes=1000)
        await asyncio.sleep(1)
        times_s = [at for at, _ in bob.arrivals]
        assert max(np.diff(times_s)) == pytest.approx(0.9, abs=0.05)
        assert max(bob.delays_s) < 0.1
        assert relay.stats()["dropped"]["replaced"] == 90 - len(times_s) > 24


@in_virtual_time
async def test_a_reader_that_stops_is_closed_and_nobody_else_notices() -> None:
    current_network().route("stuck", down=Wire(queue_bytes=2048))
    config = RelayConfig(stall_timeout_s=5, close_timeout_s=1)
    async with (
        Relay(config) as relay,
        peer_in_room(URL, "Ada") as ada,
        peer_in_room(URL, "Bob", tracks=()) as bob,
        peer_in_room("ws://stuck:8765", "Stuck", tracks=()) as stuck,
    ):
        stuck.websocket.transport.pause_reading()
        await ada.publish(num_frames=600, fps=30, num_bytes=250)
        departure = await bob.until(PeerLeft)
        await asyncio.sleep(0.001)
        assert departure == PeerLeft(peer_id=stuck.session.peer_id, reason="removed")
        assert len(bob.arrivals) == 600
        assert max(bob.delays_s) < 0.001
        assert relay.stats()["closed"] == {"4005": 1}


@in_virtual_time
async def test_a_full_relay_refuses_one_more_connection() -> None:
    async with (
        Relay(RelayConfig(max_connections=1)),
        peer_in_room(URL, "Ada"),
        peer_in_room(URL, "Bob") as bob,
    ):
        assert (await bob.until(Closed)).code == CloseCode.RELAY_FULL


@in_virtual_time
async def test_a_client_of_another_sub_protocol_is_refused_with_code_and_reason() -> None:
    async with Relay(RelayConfig()), connect(URL, proxy=None) as websocket:
        await websocket.wait_closed()
        assert websocket.close_code == CloseCode.WRONG_VERSION
        assert websocket.close_reason == "this relay speaks pica.2"


@in_virtual_time
async def test_a_relay_that_stops_says_so_to_everybody_and_leaves_no_task() -> None:
    relay = Relay(RelayConfig())
    await relay.__aenter__()
    async with peer_in_room(URL, "Ada") as ada, peer_in_room(URL, "Bob") as bob:
        await relay.__aexit__(None, None, None)
        for peer in (ada, bob):
            closed = await peer.until(Closed)
            assert closed.code == CloseCode.GOING_AWAY
        assert relay.stats()["open_connections"] == relay.stats()["rooms"] == 0


@in_virtual_time
async def test_a_relay_stops_in_time_although_a_peer_does_not_read() -> None:
    current_network().route("stuck", down=Wire(queue_bytes=2048))
    relay = Relay(RelayConfig(close_timeout_s=2))
    await relay.__aenter__()
    async with (
        peer_in_room(URL, "Ada") as ada,
        peer_in_room("ws://stuck:8765", "Stuck", tracks=()) as stuck,
    ):
        stuck.websocket.transport.pause_reading()
        await ada.publish(num_frames=60, fps=30, num_bytes=250)
        start = now()
        await relay.__aexit__(None, None, None)
        assert now() - start == pytest.approx(2, abs=0.01)
        stuck.websocket.transport.abort()


LISTED, OWN, OPEN = "https://app.example", "https://relay:8765", {"host": "0.0.0.0"}


@pytest.mark.parametrize(
    ("options", "let_in"),
    [
        ({"origins": (LISTED,)}, {LISTED}),
        ({}, set()),  # the relay's own name was made to point to this machine
        (OPEN, {OWN}),
        (OPEN | {"web": False}, set()),
    ],
)
@in_virtual_time
async def test_a_web_page_may_connect_only_if_it_is_on_the_list_or_the_relays_own(
    options: dict[str, Any], let_in: set[str]
) -> None:
    async with Relay(RelayConfig(insecure=True, **options)):
        for page in (LISTED, OWN, "https://evil.example", "http://localhost"):
            refusal = nullcontext() if page in let_in else pytest.raises(InvalidStatus, match="403")
            with refusal:
                async with connect(URL, origin=Origin(page), proxy=None, subprotocols=PICA):
                    pass
        async with peer_in_room(URL, "Ada"):
            pass


@pytest.mark.parametrize(("busy_ratio", "num_messages"), [(0.6, 8), (1.0, 1)])
@in_virtual_time
async def test_frames_wait_for_others_while_the_core_is_busy_and_not_otherwise(
    busy_ratio: float, num_messages: int
) -> None:
    async with (
        Relay(RelayConfig(), processor_s=lambda: busy_ratio * now()) as relay,
        peer_in_room(URL, "Bob", tracks=()) as bob,
        peer_in_room(URL, "Ada") as ada,
    ):
        await asyncio.sleep(1)
        before = relay.stats()["messages_out"]
        await ada.publish(num_frames=8, fps=1000)
        await asyncio.sleep(0.02)
        assert len(bob.arrivals) == 8
        assert relay.stats()["messages_out"] - before == num_messages
        assert max(bob.delays_s) < LONGEST_WAIT_S + 0.001


@in_virtual_time
async def test_a_join_that_is_refused_for_now_reports_the_reason() -> None:
    async with Relay(RelayConfig()) as relay:
        for _ in range(2):
            relay.hub.overload.note_turn(LATE_S, now())
        link = Link(LinkConfig(url=URL, room="r", connect_timeout_s=1))
        with pytest.raises(
            RelayUnreachableError, match=r"not let us in .* too much to do, try again in 5 s"
        ):
            await link.run()


@in_virtual_time
async def test_a_fault_outside_any_message_is_logged_and_ends_one_connection(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(now: float, address: str) -> None:
        raise RuntimeError("no connection")

    async with Relay(RelayConfig()) as relay:
        monkeypatch.setattr(relay.hub, "connect", fail)
        async with open_websocket(URL) as websocket:
            with pytest.raises(ConnectionClosed):
                await websocket.recv()
    assert [record.message for record in caplog.records] == ["connection failed"]


@in_virtual_time
async def test_an_admin_lists_the_rooms_over_http(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(new_key_line())
    operator = Admission(identity="op", may_admin=True)
    token = mint(load_keys(path), ANY_ROOM, operator, now=1e9, lasts_s=60)
    shown = f"Authorization: Bearer {token}"

    async with Relay(RelayConfig(keys=path, host="0.0.0.0"), unix_time=lambda: 1e9):
        reader, writer = await asyncio.open_connection("relay", 8765)
        writer.write(f"GET /rooms HTTP/1.1\r\nHost: relay\r\n{shown}\r\n\r\n".encode())
        answer = await reader.read()
        writer.close()
    assert answer.startswith(b"HTTP/1.1 200")
    assert answer.count(b"Content-Type: ") == answer.count(b"application/json") == 1


@in_virtual_time
async def test_a_key_that_is_removed_lets_nobody_in_after_ten_minutes(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(new_key_line())
    old = mint(load_keys(path), "lobby", Admission(identity="ada"), now=1e9, lasts_s=60)
    async with Relay(RelayConfig(keys=path), unix_time=lambda: 1e9):
        for what, is_let_in in (("no keys", True), (new_key_line(), False)):
            path.write_text(what)
            await asyncio.sleep(READ_AGAIN_S + 1)
            async with peer_in_room(URL, "Ada", tracks=(), token=old) as ada:
                assert (ada.session.state is State.JOINED) == is_let_in


@in_virtual_time
async def test_sockets_that_never_speak_do_not_pile_up_and_free_their_places() -> None:
    loop = asyncio.get_running_loop()
    config = RelayConfig(handshake_timeout_s=3, limits=LimitsConfig(handshakes=10))
    async with Relay(config) as relay, peer_in_room(URL, "Ada") as ada:
        lost = []

        class Mute(asyncio.Protocol):
            def connection_lost(self, exc: Exception | None) -> None:
                lost.append(now())

        for _ in range(50):
            await loop.create_connection(Mute, "relay", 8765)
        await asyncio.sleep(0.1)
        assert len(lost) == 40
        assert relay.stats()["limits_hit"] == {"sockets": 40}
        await asyncio.sleep(3)
        assert len(lost) == 50
        async with peer_in_room(URL, "Bob"):
            assert len(ada.session.peers) == 1


@in_virtual_time
async def test_a_relay_that_stops_does_not_wait_for_sockets_that_say_nothing() -> None:
    loop = asyncio.get_running_loop()
    async with Relay(RelayConfig(handshake_timeout_s=300)):
        for _ in range(50):
            await loop.create_connection(asyncio.Protocol, "relay", 8765)
        await asyncio.sleep(1)
        stops_s = now()
    assert now() - stops_s < 1


# Who stands still for a while keeps their place


@in_virtual_time
async def test_a_proxy_that_stalls_expels_nobody_whatever_their_rate() -> None:
    async with (
        Relay(RelayConfig()),
        peer_in_room("ws://train:8765", "Ada") as ada,
        peer_in_room("ws://train:8765", "Bob") as bob,
        peer_in_room("ws://relay:8765", "Cleo", tracks=()) as cleo,
    ):
        sending = [
            asyncio.create_task(peer.publish(num_frames=round(25 * fps), fps=fps))
            for peer, fps in ((ada, 30), (bob, 120))
        ]
        await asyncio.sleep(5.0)
        current_network().stall("train", 11.5)
        await asyncio.gather(*sending)
        await asyncio.sleep(0.1)
        assert not ada.told(Closed)
        assert not bob.told(Closed)
        assert max(now() - at for at, _ in cleo.arrivals[-2:]) < 0.2
        assert cleo.delays_s[-1] < 0.01


@pytest.fixture
def relay() -> Iterator[RelayProcess]:
    process = start_relay("--port", "0", "--limits.bytes-per-s", "24000")
    assert process.stderr is not None
    node = RelayProcess(process, process.stderr.readline().split()[-1])
    yield node
    process.send_signal(signal.SIGCONT)
    process.kill()
    process.communicate()


@pytest.mark.skipif(os.name == "nt", reason="stops the relay with Unix signals")
@pytest.mark.asyncio
async def test_the_kernel_holds_little_for_a_relay_that_does_not_read(relay: RelayProcess) -> None:
    """So who sends feels it, and thins its own stream."""
    async with peer_in_room(relay.url, "Ada") as ada:
        sock = ada.websocket.transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 2048)
        relay.freeze()
        num_bytes = 0
        with socket.socket(fileno=os.dup(sock.fileno())) as own:
            while select.select([], [own], [], 0.5)[1]:
                num_bytes += own.send(bytes(50))
                await asyncio.sleep(0.0002)
        ada.websocket.transport.abort()
    assert num_bytes < 32_768
