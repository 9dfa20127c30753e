"""Run a command and append its result, with commit and machine, to docs/results/NAME.jsonl.

python scripts/record_result.py call bench call --seconds 20
python scripts/record_result.py recipes scripts/training_trials.py recipes --capture captures/S1
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def git(*words: str) -> str:
    """What git answers, without the newline."""
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def processor() -> str:
    """The processor's name, or what Python knows of it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def load_now() -> float | None:
    """How busy the machine has been in the last minute; None where nobody counts."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def append_result(name: str, command: str, result: Any, load_before: float | None) -> None:
    """Append a line about one run to docs/results/NAME.jsonl."""
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":!docs")
    row = {
        "date": datetime.date.today().isoformat(),
        "commit": git("rev-parse", "--short", "HEAD") + ("+changes" if changed else ""),
        "command": command,
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "system": f"{platform.system()} {platform.machine()}",
            "python": platform.python_version(),
            "load_before": load_before,
        },
        "result": result,
    }
    path = ROOT / "docs" / "results" / f"{name}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
    print(f"appended to {path.relative_to(ROOT)}", file=sys.stderr)


def main() -> None:
    """Run, read the last line of stdout, append one line."""
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    name, words = sys.argv[1], sys.argv[2:]
    is_script = words[0].endswith(".py")
    run_as = words if is_script else ["-m", "pica_command", *words, "--json"]
    command = [sys.executable, *run_as]
    load_before = load_now()
    run = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if run.returncode:
        sys.exit(run.returncode)
    result = json.loads(run.stdout.splitlines()[-1])
    append_result(name, " ".join(words if is_script else ("pica", *words)), result, load_before)


if __name__ == "__main__":
    main()
