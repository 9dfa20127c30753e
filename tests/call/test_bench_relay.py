"""The load generator against real relays: what can be counted, never how fast it was."""

import os
from pathlib import Path

import pytest

from malice import clients
from pica_client.bench.relay.bench import Load, RelayBenchConfig, relay_target
from pica_client.bench.relay.processes import Workers, memory_bytes, relay_metrics
from pica_client.errors import OptionError
from pica_client.local_call.processes import Children
from rivals.comparison import run_comparison

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("the load generator waits on pipes and sockets together", allow_module_level=True)

KEYS = {
    *("rooms", "peers", "fps", "seconds", "delivered_per_s", "forward_ms", "dropped"),
    *("relay_cpu_s_per_1000", "bytes_per_connection", "errors"),
}
OFFENDERS = Path(clients.__file__)
QUICK = ("--stall-timeout-s", "1", "--handshake-timeout-s", "1", "--close-timeout-s", "0.5")
OFFENCE_S = 4.0
MAX_GROWTH_BYTES = 32_000_000
"""Of a relay's memory by all offenders together: 225 connections with full queues, and to spare."""


def test_everybody_gets_every_frame_from_relay_naive_relay_and_echo() -> None:
    config = RelayBenchConfig(rooms=2, seconds=1.0)
    result = run_comparison(config, compare=("naive", "echo"))
    assert result.keys() >= KEYS
    for row in (result, *result["compare"].values()):
        assert row["connections"] == 10
        assert row["sent_per_s"] == pytest.approx(300, rel=0.1)
        assert (row["missing"], row["errors"]) == (0, 0)
    assert result["dropped"] == 0


def test_offenders_get_their_close_codes_and_healthy_rooms_their_frames() -> None:
    kinds = ("stopped-reader", "flood", "slow-loris", "half-open", "large-messages", "bombs")
    config = RelayBenchConfig(rooms=3, seconds=3.0, relay_arguments=QUICK)
    with Workers() as workers, Children() as children, relay_target(config, children) as target:
        assert target.pid is not None
        load = Load(config, target, workers)
        load.connect()
        before = memory_bytes(target.pid) or 0
        offenders = {
            kind: workers.start(OFFENDERS, kind, target.url, load.room(0), str(OFFENCE_S))
            for kind in kinds
        }
        beside = load.measure()
        reports = {kind: worker.answer(30.0) for kind, worker in offenders.items()}
        metrics = relay_metrics(target.url)
        peak = memory_bytes(target.pid, "VmHWM") or 0
        load.leave()
    # A relay that the machine holds up for half a second drops what has grown old.
    assert beside["missing"] < 0.01 * config.rooms * 5 * 4 * 30 * config.seconds
    assert beside["errors"] == 0
    assert metrics['pica_closed_total{code="4005"}'] == 1  # it reads nothing, not even this
    assert reports["flood"]["codes"]["4008"] >= 1
    assert reports["slow-loris"]["cut"] == reports["slow-loris"]["attempts"]
    assert reports["half-open"]["cut"] == reports["half-open"]["attempts"]
    assert set(reports["half-open"]["websockets"]) == {"4003"}
    assert set(reports["large-messages"]["codes"]) == {"1009"}
    assert set(reports["bombs"]["codes"]) == {"4000"}
    assert peak - before < MAX_GROWTH_BYTES


def test_a_slow_reader_stays_while_it_reads_and_costs_nobody_else_a_frame() -> None:
    config = RelayBenchConfig(rooms=2, seconds=2.0)
    with Workers() as workers, Children() as children, relay_target(config, children) as target:
        load = Load(config, target, workers)
        load.connect()
        slow = workers.start(OFFENDERS, "slow-reader", target.url, load.room(0), "4")
        beside = load.measure()
        report = slow.answer(30.0)
        load.leave()
    assert report["codes"] == {"none": 1}
    assert report["read_bytes"] > 0
    assert beside["missing"] == 0


def test_a_server_to_compare_with_that_is_unknown_is_named() -> None:
    with pytest.raises(OptionError, match="compare 'fast' is unknown; known are naive"):
        run_comparison(RelayBenchConfig(url="ws://example.org"), compare=("fast",))
