"""Charts of `pica bench call` with a worsened network: real calls through a bad one."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
from charting import LIMITS_PAGE, Line, fill_in, finish, number_ticks, read_lines, save, table
from matplotlib.figure import Figure


def chart_impaired_call() -> None:
    """Rendered error and age of the face in real calls, by what was done to their network."""
    newest = {line["command"]: line for line in read_lines("impaired-call")}
    lines = list(newest.values())
    if not lines:
        return
    save(_draw_impaired_calls(lines), "impaired-call")
    age = "{rendered[age_ms]"
    rows = [line["result"] | {"network": _network(line)} for line in lines]
    shown = table(
        rows,
        {
            "network": "network",
            "peers": "peers",
            "sample to decoded p50 / p95, ms": "{latency_ms[p50]:.0f} / {latency_ms[p95]:.0f}",
            "age on the display p50 / p95, ms": f"{age}[p50]:.0f}} / {age}[p95]:.0f}}",
            "MSE, usual delay": "{rendered[mse_delayed]:.1f}",
            "MSE, now": "{rendered[mse_now]:.0f}",
            "concealed": "{rendered[concealed_ratio]:.1%}",
            "largest step": "{rendered[largest_step]:.2f}",
        },
    )
    fill_in(LIMITS_PAGE, "impaired-call", f"{shown}\n\n{_source(lines)}")


def _source(lines: Sequence[Line]) -> str:
    return f"{lines[-1]['date']} · commit {lines[-1]['commit']} · pica bench call"


def _network(line: Line) -> str:
    """What a line's command did to the network, in words."""
    way = line["result"]["impairment"]
    texts = (
        ("jitter_s", 1e3, "jitter {:g} ms"),
        ("stall_s", 1e3, "stalls {:g} ms"),
        ("loss_ratio", 1, "{:.0%} lost"),
        ("rate_bps", 1e-3, "{:g} kbit/s"),
    )
    parts = [text.format(way[name] * factor) for name, factor, text in texts if way[name]]
    if "--plain" in line["command"]:
        parts.append("plain 8 bit")
    return ", ".join(parts) or "no trouble"


def _draw_impaired_calls(lines: Sequence[Line]) -> Figure:
    figure, (errors, ages) = plt.subplots(
        2, 1, figsize=(max(0.95 * len(lines), 6), 5.6), sharex=True, layout="constrained"
    )
    places = range(len(lines))
    rendered = [line["result"]["rendered"] for line in lines]
    errors.plot(places, [row["mse_delayed"] for row in rendered], "o", label="at its usual delay")
    errors.plot(places, [row["mse_now"] for row in rendered], "^", label="now", color="#777777")
    errors.set_ylabel("rendered MSE, 0–255,\nagainst the undisturbed stream")
    for percent, marker in (("p50", "o"), ("p95", "_")):
        points = [row["age_ms"][percent] for row in rendered]
        ages.plot(places, points, marker, label=percent, color="#0072B2")
    ages.set_ylabel("age of the face\non the display, ms")
    for axis in (errors, ages):
        axis.set_yscale("log")
        number_ticks(axis.yaxis)
        axis.legend(frameon=False)
    ages.set_xticks(list(places), [_network(line).replace(", ", ",\n") for line in lines])
    ages.tick_params(axis="x", labelsize=7)
    result = lines[0]["result"]
    title = (
        f"Real calls of {result['peers']} peers through a worse network, "
        f"{result['impairment']['delay_s'] * 1e3:g} ms each way"
    )
    return finish(figure, f"{_source(lines)} on loopback", title)
