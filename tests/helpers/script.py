"""Scripts of the project as modules, for tests of what they do."""

import importlib.util
import sys
from types import ModuleType

from helpers.paths import ROOT


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
