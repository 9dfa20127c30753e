"""Where this checkout and its golden files are, and its scripts as modules."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"
SHARED_DATA = ROOT.parent / "shared" / "data"
"""Real inputs beside the checkout; tests that need them skip where they are absent."""


def load_script(name: str) -> ModuleType:
    """``scripts/NAME.py``, and what it imports from beside itself."""
    folder = ROOT / "scripts"
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules[name] = script  # its dataclasses look there
    spec.loader.exec_module(script)
    return script
