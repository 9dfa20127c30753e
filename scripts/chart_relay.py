"""What a relay carries: latency, throughput and cost against the number of rooms; misbehaving
clients; long runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
from charting import (
    RESULTS,
    Column,
    Line,
    Row,
    fill_in,
    finish,
    plain_ticks,
    read_lines,
    save,
    source_line,
    table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PAGE = RESULTS / "relay.md"
STYLE: dict[str, dict[str, Any]] = {
    "relay": {"label": "pica relay", "color": "#0072B2", "marker": "o"},
    "gather": {"label": "pica relay, nothing gathers", "color": "#56B4E9", "marker": "v"},
    "naive": {"label": "naive, same library", "color": "#D55E00", "marker": "s"},
    "naive-uvloop": {"label": "naive, with uvloop", "color": "#E69F00", "marker": "^"},
    "echo": {"label": "echo: the generator's limit", "color": "#777777", "marker": "."},
}


def chart_relay() -> None:
    """Each number of rooms of the newest commit, a soak and misbehaving clients.

    Of several runs of one load the one stands for all whose processor time is the median.
    """
    lines = read_lines("relay")
    loads = [line for line in lines if "forward_ms" in line["result"]]
    if loads:
        newest = [line for line in loads if line["commit"] == loads[-1]["commit"]]
        ordered = []
        for rooms in sorted({line["result"]["rooms"] for line in newest}):
            runs = [line for line in newest if line["result"]["rooms"] == rooms]
            runs.sort(key=lambda line: line["result"]["relay_cpu_s_per_1000"])
            ordered.append(runs[len(runs) // 2])
        save(_draw_load(ordered), "relay")
        fill_in(PAGE, "relay-load", _load_table(ordered))
    overloads = {(x["result"]["rooms"], x["commit"]): x for x in read_lines("relay-overload")}
    if overloads:
        fill_in(PAGE, "relay-overload", _overload_table(list(overloads.values())))
    for key, draw in (("hostile", _fill_hostile), ("soak", _draw_soak)):
        newest = [line for line in lines if key in line["result"]]
        if newest:
            draw(newest[-1])


def _servers(line: Line) -> dict[str, Row]:
    """What was measured of each server under one load, and of the relay where nothing gathers."""
    result = line["result"]
    ablated = {name: row for name, row in result.get("ablate", {}).items() if name == "gather"}
    return {"relay": result, **ablated, **result.get("compare", {})}


def _draw_load(lines: Sequence[Line]) -> Figure:
    figure, axes = plt.subplots(3, 1, figsize=(6.4, 7.6), sharex=True, layout="constrained")
    delivered, latency, cost = axes
    for name in dict.fromkeys(name for line in lines for name in _servers(line)):
        rows = [servers[name] for line in lines if name in (servers := _servers(line))]
        rooms = [row["rooms"] for row in rows]
        style = STYLE[name]
        delivered.plot(rooms, [row["delivered_per_s"] / 1e3 for row in rows], **style)
        latency.plot(rooms, [row["forward_ms"]["p99"] for row in rows], **style)
        if name != "echo":
            _plot_known(cost, rows, lambda row: row["relay_cpu_s_per_1000"], style)
    result = lines[-1]["result"]
    delivered.set_ylabel("delivered, 1,000 frames/s")
    delivered.legend(frameon=False, fontsize=8)
    latency.set_yscale("log")
    plain_ticks(latency.yaxis)
    latency.axhline(10, color="#333333", linewidth=0.8, linestyle=":")
    latency.annotate(
        "10 ms", (1, 10), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8
    )
    latency.set_ylabel("forwarding p99, ms\n(send call to receive call)")
    cost.set_ylabel("processor time for\n1,000 frames delivered, s")
    cost.set_ylim(bottom=0)
    cost.set_xlabel(f"rooms of {result['peers']} at {result['fps']:g} frames/s each")
    title = "One relay process on one core, the load on the other"
    return finish(figure, lines[-1], title, size=6)


def _plot_known(
    axis: Axes, rows: Sequence[Row], value: Callable[[Row], float | None], style: dict[str, Any]
) -> None:
    known = [(row["rooms"], cost) for row in rows if (cost := value(row)) is not None]
    axis.plot([rooms for rooms, _ in known], [cost for _, cost in known], **style)


def _load_table(lines: Sequence[Line]) -> str:
    rows = [
        row | {"rooms": row["rooms"] if name == "relay" else "", "server": name}
        for line in lines
        for name, row in _servers(line).items()
    ]
    columns: dict[str, Column] = {
        "rooms": "rooms",
        "server": lambda row: STYLE[row["server"]]["label"],
        "delivered/s": "{delivered_per_s:,.0f}",
        "p50 / p99, ms": lambda row: " / ".join(_ms(row["forward_ms"][p]) for p in ("p50", "p99")),
        "missing": "missing",
        "dropped": lambda row: row["dropped"] if row["server"] in ("relay", "gather") else None,
        "core busy": lambda row: (
            None if row["relay_cpu_ratio"] is None else f"{row['relay_cpu_ratio']:.0%}"
        ),
        "s per 1,000": "relay_cpu_s_per_1000",
        "frames/message": "frames_per_message",
        "bytes/connection": "bytes_per_connection",
    }
    capacities = [line for line in lines if "capacity" in line["result"]]
    text = table(rows, columns)
    if capacities:
        found = [
            f"{STYLE[name]['label']} {row['capacity']['rooms']}"
            + ("" if row["capacity"]["is_limit"] else " or more")
            for name, row in _servers(capacities[-1]).items()
        ]
        bar = capacities[-1]["result"]["capacity"]["bar_ms"]
        text += f"\n\nMost rooms with p99 within {bar:g} ms: {', '.join(found)}."
    return f"{text}\n\n{source_line(lines[-1])}"


def _overload_table(lines: Sequence[Line]) -> str:
    """Each number of rooms and commit: what came, how old, what was dropped, and who was closed."""
    lines = sorted(lines, key=lambda line: (line["result"]["rooms"], line["date"]))
    rows = [line["result"] | {"commit": line["commit"]} for line in lines]
    text = table(
        rows,
        {
            "rooms": "rooms",
            "commit": "commit",
            "delivered/s": "{delivered_per_s:,.0f}",
            "p50 / p99, ms": lambda r: " / ".join(_ms(r["forward_ms"][p]) for p in ("p50", "p99")),
            "dropped": "{dropped:,}",
            "missing besides": lambda r: f"{r['missing'] - r['dropped']:,}",
            "not sent": lambda r: f"{r['blocked']:,}",
            "peers closed": lambda r: _codes(r["close_codes"]),
            "core busy": "{relay_cpu_ratio:.0%}",
        },
    )
    return f"{text}\n\n{source_line(lines[-1])}"


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _fill_hostile(line: Line) -> None:
    """What changes for healthy rooms beside each offender."""
    result = line["result"]
    columns: dict[str, Column] = {
        "offender": "kind",
        "p99 before / beside, ms": lambda row: " / ".join(
            _ms(row[when]["forward_ms"]["p99"]) for when in ("before", "beside")
        ),
        "change": lambda row: None if row["p99_change"] is None else f"{row['p99_change']:+.0%}",
        "frames missing": "{beside[missing]}",
        "relay's peak, MB": lambda row: f"{row['relay_peak_bytes'] / 1e6:.1f}",
        "relay closed": lambda row: _codes(row["relay_closed"]),
        "offender saw": lambda row: (
            _codes(row["offender"]["codes"])
            + (f", {row['offender']['cut']} cut" if "cut" in row["offender"] else "")
        ),
    }
    load = f"{result['rooms']} healthy rooms of {result['peers']} at {result['fps']:g} frames/s"
    text = f"{load}.\n\n{table(result['hostile'], columns)}\n\n{source_line(line)}"
    fill_in(PAGE, "relay-hostile", text)


def _codes(codes: dict[str, int]) -> str:
    return ", ".join(f"{count} × {code}" for code, count in codes.items()) or "–"


def _draw_soak(line: Line) -> None:
    """Memory and latency over time."""
    result = line["result"]
    rows: list[Row] = result["soak"]
    minutes = [(index + 1) * result["minutes"] / len(rows) for index in range(len(rows))]
    figure, (memory, latency) = plt.subplots(
        2, 1, figsize=(6.4, 4.2), sharex=True, layout="constrained"
    )
    memory.plot(minutes, [row["relay_bytes"] / 1e6 for row in rows], ".-", color="#0072B2")
    memory.set_ylabel("relay's memory, MB")
    memory.set_ylim(bottom=0)
    for percent, color in (("p50", "#56B4E9"), ("p99", "#0072B2")):
        values = [row["forward_ms"][percent] for row in rows]
        latency.plot(minutes, values, ".-", color=color, label=percent)
    latency.set_ylabel("forwarding, ms")
    latency.set_ylim(bottom=0)
    latency.legend(frameon=False, fontsize=8)
    latency.set_xlabel("minutes")
    title = f"{result['rooms']} rooms of {result['peers']} for long"
    save(finish(figure, line, title, size=6), "relay-soak")
    drain = result["drain"]
    fill_in(
        PAGE,
        "relay-soak",
        f"{result['minutes']:g} minutes, {result['rooms']} rooms of {result['peers']}: memory "
        f"{result['memory_growth']:+.1%}, p99 {result['p99_growth']:+.1%} from the first third to "
        f"the last.\nThen SIGTERM: {drain['connections']} connections closed in "
        f"{drain['seconds']:g} s ({_codes(drain['close_codes'])}), {drain['whispers_passed']} "
        f"whispers passed on in that time, {drain['lost_control']} control messages lost.\n\n"
        f"{source_line(line)}",
    )
