"""Where this checkout and its golden files are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"
SHARED_DATA = ROOT.parent / "shared" / "data"
"""Real inputs beside the checkout; tests that need them skip where they are absent."""
