"""Measure what a change of the code must not make worse, alone or in turns with another checkout.

    python scripts/fence.py                            every row, about a quarter of an hour
    python scripts/fence.py --only demo call           some rows
    python scripts/fence.py --against ../before        each row in turns with that checkout
    python scripts/fence.py --against ../before --record
    python scripts/fence.py --against HEAD~20 --only demo

Each checkout measures itself with its own ``scripts/fence.py`` and options. A folder needs a
``.venv`` of its own; a commit is checked out under out/fence and measured with this environment.
Both train on the same capture. Figures are medians over the repeats,
with the lowest and the highest; compare ratios of one run on one machine, which nothing else uses.
``--record`` appends a line for each row to docs/results/fence.jsonl.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TAKE = ROOT.parent / "shared/data/livelink/range_of_motion.csv"
"""A real performance; the row that needs it is left out where it is absent."""
FAULTS = (
    "relay paused 13 s", "relay paused 7 s at 120", "proxy stalls", "one sender paused 20 s",
    "viewer paused 20 s", "everything paused", "relay killed, back after 1.5 s",
    "one sender killed", "relay's log", "way lost without", "way lost, the address", "wrong keys",
)  # fmt: skip
Figures = dict[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One command, and the figures that are read from its JSON."""

    words: str
    """Words for ``pica``, or for Python if they begin with a path; ``{work}`` is a folder of this
    checkout, ``{capture}`` the capture and ``{take}`` the performance."""
    figures: Callable[[dict[str, Any]], Figures]
    repeats: int = 1


def _relay(result: dict[str, Any]) -> Figures:
    found = {}
    for name, each in (("", result), ("naive ", result["compare"]["naive"])):
        found[f"{name}cpu_s_per_1000"] = each["relay_cpu_s_per_1000"]
        found |= {f"{name}{key}_ms": each["forward_ms"][key] for key in ("p50", "p99")}
    return found


def _latency(result: dict[str, Any]) -> Figures:
    return {f"{key}_ms": result["latency_ms"][key] for key in ("p50", "p99")}


def _call(result: dict[str, Any]) -> Figures:
    wire = [each["wire"] for each in result["bitrate_bps"].values()]
    kept = 1.0 - result["concealed"] / max(result["seconds"] * 30.0 * result["peers"], 1.0)
    alone = {
        f"without playout {key}_ms": result["without_playout_ms"][key] for key in ("p50", "p99")
    }
    return _latency(result) | alone | {"wire_bps": statistics.mean(wire), "kept_ratio": kept}


def _demo(result: dict[str, Any]) -> Figures:
    voice = result["voice"]
    return _latency(result) | {
        "images_per_s": result["render_fps"],
        "decodes_per_s": result["decodes_per_s"],
        "mouth_to_ear_p50_ms": voice["mouth_to_ear_ms"]["p50"],
        "skew_p95_ms": voice["skew_ms"]["p95"],
    }


def _decode(result: dict[str, Any]) -> Figures:
    ratios = result["baseline_ratio"]
    found = {f"baseline_ratio_{level}": value for level, value in ratios.items()}
    for row in result["rows"]:
        if row["work"] == "draw" and row["level"] == 256:
            found[f"draw_ratio_{row['distance_cm']:g}cm"] = row["over_baseline"]
        if row["work"] == "decode" and row["parts"] == "expression":
            found[f"ms_{row['level']}"] = row["ms"]
    return found


def _scene(result: dict[str, Any]) -> Figures:
    found = {}
    for scene in result["summary"]["scenes"]:
        name = f"{scene['distance_cm']:g}cm"
        found[f"over_full_screen_{name}"] = scene["scheduled_over_full_screen"]
        found[f"error_{name}"] = scene["error"]
    return found


def _drive(result: dict[str, Any]) -> Figures:
    keys = ("mse", "lid_mm", "lip_mm")
    return {f"{key}_{row['level']}": row[key] for row in result["rows"] for key in keys}


def _voice(result: dict[str, Any]) -> Figures:
    found = {}
    for row in result["rows"]:
        name = row["condition"]
        found[f"{name} pesq"] = row["pesq"]
        found[f"{name} concealed_ratio"] = row["concealed_ratio"]
        found[f"{name} mouth_to_ear_p50_ms"] = row["mouth_to_ear_ms"]["p50"]
        found[f"{name} skew_p95_ms"] = row["skew_ms"]["p95"]
    return found


def _training(result: dict[str, Any]) -> Figures:
    found: Figures = {}
    for variant in ("linear", "full", "baseline"):
        rows = [row for row in result["rows"] if row["variant"] == variant]
        for key in ("mse", "live_mse", "vertex_error_mm"):
            values = [row[key] for row in rows if row.get(key) is not None]
            if values:
                found[f"{variant} {key}"] = statistics.mean(values)
    return found


def _faults(result: dict[str, Any]) -> Figures:
    found: Figures = {}
    for row in result["faults"]:
        found[f"{row['fault']}: alive"] = float(row["survived"].split()[0])
        found[f"{row['fault']}: back_after_s"] = row["back_after_s"]
    return found


RELAY = "tests/rivals/comparison.py --rooms {rooms} --seconds 6"
RUNS = " ".join(f"{{work}}/claim/capture-{name}-0" for name in ("linear", "full", "baseline"))
DRIVE = (
    "bench drive --avatar {name} --person scripts/people/{name}.json --sources csv:{{take}} "
    "--seconds 130 --moments 12"
)
ROWS: dict[str, Row] = {
    "relay 60": Row(words=RELAY.format(rooms=60), figures=_relay, repeats=3),
    "relay 100": Row(words=RELAY.format(rooms=100), figures=_relay, repeats=3),
    "call": Row(words="bench call --seconds 10", figures=_call, repeats=3),
    "decode": Row(words="bench decode --rounds 30", figures=_decode),
    "scene": Row(words="bench scene --rounds 4", figures=_scene),
    "drive amara": Row(words=DRIVE.format(name="amara"), figures=_drive),
    "drive yun": Row(words=DRIVE.format(name="yun"), figures=_drive),
    "claim": Row(
        words="bench claim --captures {capture} --out {work}/claim --preset tiny --seeds 1 "
        "--eval-frames 5",
        figures=_training,
    ),
    "eval": Row(words=f"eval --frames 5 --runs {RUNS}", figures=_training),
    "demo": Row(
        words="demo --headless --size 1280x720 --seconds 10 --out {work}/demo",
        figures=_demo,
        repeats=3,
    ),
    "voice": Row(words="bench voice --scenarios jitter-0,rate-64,retransmit-5", figures=_voice),
    "faults": Row(
        words=" ".join(["tests/faults.py --json", *(f'"{name}"' for name in FAULTS)]),
        figures=_faults,
    ),
}
CAPTURE = "capture person --seed 20261 --frames 24 --cameras 6 --size 256x192 --out {capture}"


def run(words: str, work: Path, capture: Path) -> dict[str, Any]:
    """Run a command of this checkout and return the JSON object of its last line."""
    given = [w.format(work=work, capture=capture, take=TAKE) for w in shlex.split(words)]
    head = [sys.executable] if given[0].endswith(".py") else [sys.executable, "-m", "pica_command"]
    tail = [] if given[0].endswith(".py") else ["--json"]
    done = subprocess.run([*head, *given, *tail], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"fence: {' '.join(given)} ended with {done.returncode}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def from_clone(work: Path) -> Figures:
    """Seconds from a clone of this checkout in an empty folder to the end of its ``make demo``."""
    shutil.rmtree(work / "clone", ignore_errors=True)
    started = time.monotonic()
    subprocess.run(["git", "clone", "-q", str(ROOT), str(work / "clone")], check=True)
    words = ["make", "-s", "-C", str(work / "clone"), "demo", "DEMO=--headless --seconds 10"]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return {"seconds": round(time.monotonic() - started, 1)}


def measure(name: str, work: Path, capture: Path) -> Figures:
    """Measure one row of this checkout."""
    if name == "clone":
        return from_clone(work)
    shutil.rmtree(work / "claim" if name == "claim" else work / name, ignore_errors=True)
    return ROWS[name].figures(run(ROWS[name].words, work, capture))


def checkout_of(folder_or_commit: str, work: Path) -> Path:
    """A folder as it is, or a worktree of a commit under `work`."""
    if Path(folder_or_commit).is_dir():
        return Path(folder_or_commit).resolve()
    folder = work / "against"
    git = ["git", "-C", str(ROOT), "worktree"]
    if folder.exists():
        subprocess.run([*git, "remove", "--force", str(folder)], check=True)
    subprocess.run([*git, "add", "-q", "--detach", str(folder), folder_or_commit], check=True)
    return folder


def measure_there(checkout: Path, name: str, capture: Path) -> Figures:
    """Let another checkout measure a row of itself, with its environment or else with this one."""
    own = checkout / ".venv" / "bin" / "python"
    words = [str(own) if own.exists() else sys.executable, f"{checkout}/scripts/fence.py", "--once"]
    words += ["--only", name, "--capture", str(capture)]
    packages = ("protocol", "server", "pica_core", "client", "command")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(str(checkout / p) for p in packages)}
    done = subprocess.run(
        words, check=True, stdout=subprocess.PIPE, text=True, cwd=checkout, env=environment
    )
    return dict(json.loads(done.stdout.splitlines()[-1])[name])


def commit(checkout: Path) -> str:
    """The commit of a checkout, and whether it has changes."""
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def summary(found: list[Figures]) -> dict[str, list[float]]:
    """Median, lowest and highest of each figure over the repeats."""
    names = [name for name in found[0] if all(each.get(name) is not None for each in found)]
    values = {name: [each[name] for each in found] for name in names}
    return {
        name: [float(f"{number:.6g}") for number in (statistics.median(v), min(v), max(v))]
        for name, v in values.items()
    }


def main() -> None:
    """Read the command line, measure, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=[*ROWS, "clone"], default=[*ROWS, "clone"])
    parser.add_argument("--against", help="another checkout with a .venv, or a commit")
    parser.add_argument("--capture", type=Path, help="instead of one that is rendered first")
    parser.add_argument("--record", action="store_true", help="append to docs/results/fence.jsonl")
    parser.add_argument("--once", action="store_true", help="no repeats; print figures as JSON")
    options = parser.parse_args()
    work = ROOT / "out" / "fence"
    work.mkdir(parents=True, exist_ok=True)
    capture = (options.capture or work / "capture").resolve()
    if "claim" in options.only and not capture.exists():
        run(CAPTURE, work, capture)
    names = [n for n in options.only if not n.startswith("drive") or TAKE.exists()]
    if options.once:
        print(json.dumps({name: measure(name, work, capture) for name in names}))
        return
    lines = []
    other = checkout_of(options.against, work) if options.against else None
    for name in names:
        here, there = list[Figures](), list[Figures]()
        for _ in range(ROWS[name].repeats if name in ROWS else 1):
            if other:
                there.append(measure_there(other, name, capture))
            here.append(measure(name, work, capture))
        now, before = summary(here), summary(there) if there else {}
        print(name)
        for figure, (middle, low, high) in now.items():
            old = before.get(figure)
            ratio = f"{middle / old[0]:.3f}" if old and old[0] else ""
            told = "" if old is None else f"{old[0]:>10g} [{old[1]:g}, {old[2]:g}]"
            print(f"  {figure:<58}{told:>32}{middle:>10g} [{low:g}, {high:g}] {ratio:>7}")
        sys.stdout.flush()
        for checkout, figures in ((other, before), (ROOT, now)):
            if checkout and figures:
                lines.append({"row": name, "commit": commit(checkout), "figures": figures})
    if options.record:
        about = {
            "date": datetime.date.today().isoformat(),
            "machine": f"{platform.machine()}, {os.cpu_count()} cores",
            "median_low_high": True,
        }
        with (ROOT / "docs" / "results" / "fence.jsonl").open("a") as file:
            file.writelines(json.dumps(about | line) + "\n" for line in lines)


if __name__ == "__main__":
    main()
