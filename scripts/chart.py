"""Redraw the charts and tables of docs/ from the lines in docs/results/, without measuring.

python scripts/chart.py            all of them
python scripts/chart.py playout    one

Each takes the newest line of every kind of run it shows. Charts are SVG with a source line: date,
commit and command of what they show.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from chart_calls import chart_impaired_call
from chart_codec import chart_codec
from chart_drive import chart_drive
from chart_faults import chart_faults
from chart_models import chart_models
from chart_playout import chart_playout
from chart_receiver import chart_receiver
from chart_relay import chart_relay
from chart_tables import chart_tables
from chart_training import chart_curves, chart_failures, chart_recipes, chart_step
from chart_voice import chart_voice

CHARTS: dict[str, Callable[[], None]] = {
    "playout": chart_playout,
    "impaired-call": chart_impaired_call,
    "codec": chart_codec,
    "relay": chart_relay,
    "drive": chart_drive,
    "faults": chart_faults,
    "receiver": chart_receiver,
    "models": chart_models,
    "tables": chart_tables,
    "recipes": chart_recipes,
    "training-curves": chart_curves,
    "failures": chart_failures,
    "training-step": chart_step,
    "voice": chart_voice,
}


def main() -> None:
    """Draw what is named, or all."""
    names = sys.argv[1:] or list(CHARTS)
    for name in names:
        if name not in CHARTS:
            sys.exit(f"chart {name!r} is unknown; known are {', '.join(CHARTS)}")
        CHARTS[name]()


if __name__ == "__main__":
    main()
