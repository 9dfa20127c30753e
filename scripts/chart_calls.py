"""Charts of `pica bench call` with a worsened network: real calls through a bad one."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
from charting import LIMITS_PAGE, Line, fill_in, markdown_table, read_lines, save
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter


def chart_impaired_call() -> None:
    """Rendered error and age of the face in real calls, by what was done to their network."""
    newest = {line["command"]: line for line in read_lines("impaired-call")}
    lines = list(newest.values())
    if not lines:
        return
    save(_draw_impaired_calls(lines), "impaired-call")
    header = (
        "network",
        "peers",
        "sample to decoded p50 / p95, ms",
        "age on the display p50 / p95, ms",
        "MSE, usual delay",
        "MSE, now",
        "concealed",
        "largest step",
    )
    rows = []
    for line in lines:
        result = line["result"]
        rendered, latency = result["rendered"], result["latency_ms"]
        rows.append(
            (
                _network(line),
                result["peers"],
                f"{latency['p50']:.0f} / {latency['p95']:.0f}",
                f"{rendered['age_ms']['p50']:.0f} / {rendered['age_ms']['p95']:.0f}",
                f"{rendered['mse_delayed']:.1f}",
                f"{rendered['mse_now']:.0f}",
                f"{rendered['concealed_ratio']:.1%}",
                f"{rendered['largest_step']:.2f}",
            )
        )
    newest_line = lines[-1]
    source = f"{newest_line['date']} · commit {newest_line['commit']} · pica bench call"
    fill_in(LIMITS_PAGE, "impaired-call", f"{markdown_table(header, rows)}\n\n{source}")


def _network(line: Line) -> str:
    """What a line's command did to the network, in words."""
    way = line["result"]["impairment"]
    parts = []
    if way["jitter_s"]:
        parts.append(f"jitter {way['jitter_s'] * 1e3:g} ms")
    if way["stall_s"]:
        parts.append(f"stalls {way['stall_s'] * 1e3:g} ms")
    if way["loss_ratio"]:
        parts.append(f"{way['loss_ratio']:.0%} lost")
    if way["rate_bps"]:
        parts.append(f"{way['rate_bps'] / 1e3:g} kbit/s")
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
    errors.set_yscale("log")
    errors.set_ylabel("rendered MSE, 0–255,\nagainst the undisturbed stream")
    errors.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    errors.legend(frameon=False)
    for percent, marker in (("p50", "o"), ("p95", "_")):
        ages.plot(
            places,
            [row["age_ms"][percent] for row in rendered],
            marker,
            label=percent,
            color="#0072B2",
        )
    ages.set_yscale("log")
    ages.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    ages.set_ylabel("age of the face\non the display, ms")
    ages.legend(frameon=False)
    ages.set_xticks(list(places), [_network(line).replace(", ", ",\n") for line in lines])
    ages.tick_params(axis="x", labelsize=7)
    figure.suptitle(
        f"Real calls of {lines[0]['result']['peers']} peers through a worse network, "
        f"{lines[0]['result']['impairment']['delay_s'] * 1e3:g} ms each way",
        fontsize=10,
    )
    figure.supxlabel(
        f"{lines[-1]['date']} · commit {lines[-1]['commit']} · pica bench call on loopback",
        fontsize=7,
        color="#555555",
    )
    return figure
