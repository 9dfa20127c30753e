"""What this machine can do, and the fix for each lack."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

from pica_client.avatars.library import shipped_avatar_files
from pica_client.output import say
from pica_client.ui.display import has_display
from pica_core.errors import GraphicsError

DISTRIBUTION = "pica-telepresence"
EXTRAS = {
    "send": ("numpy", "safetensors"),
    "view": ("moderngl", "glfw", "onnx", "onnxruntime", "PIL"),
    "video": ("av",),
    "train": ("torch",),
}
"""Each extra by what its modules are called."""

Level = Literal["good", "lacking"]


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorOptions:
    """``pica doctor`` has no options."""


def doctor(options: DoctorOptions) -> dict[str, Any]:
    """Say what this machine can do: GL, inference, display, extras, with the fix for each lack."""
    findings = examine(has_display=has_display)
    for finding in findings:
        say(finding.line)
    return {"findings": [asdict(finding) for finding in findings]}


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the examination."""

    subject: str
    level: Level
    detail: str
    fix: str = ""

    @property
    def line(self) -> str:
        """The finding as people read it."""
        mark = "ok  " if self.level == "good" else "LACK"
        fix = f" -> {self.fix}" if self.fix else ""
        return f"{mark}  {self.subject}: {self.detail}{fix}"


def load_module(name: str) -> Any:
    """Import a module by name; ONNX Runtime comes with its telemetry off, as everywhere."""
    if name == "onnxruntime":
        return importlib.import_module("pica_client.decode.onnx_runtime").onnxruntime
    return importlib.import_module(name)


def examine(
    load: Callable[[str], Any] = load_module,
    *,
    has_display: Callable[[], bool],
) -> list[Finding]:
    """Look at everything a sender, a viewer and a trainer need.

    Args:
        load: Imports a module by name; tests give another.
        has_display: Whether a window can be expected to open.
    """
    extras = (_extra(extra, modules, load) for extra, modules in EXTRAS.items())
    return [*extras, _graphics(load), _inference(load), _display(has_display()), _avatars()]


def _extra(extra: str, modules: tuple[str, ...], load: Callable[[str], Any]) -> Finding:
    lacking = []
    for module in modules:
        try:
            load(module)
        except Exception as error:  # a broken install fails in ways of its own
            kind = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
            lacking.append(f"{module}{kind}")
    if not lacking:
        return Finding(f"extra {extra}", "good", "installed")
    fix = f"pip install '{DISTRIBUTION}[{extra}]'"
    return Finding(f"extra {extra}", "lacking", f"no {', '.join(lacking)}", fix)


def _graphics(load: Callable[[str], Any]) -> Finding:
    try:
        context = load("pica_core.gl").create_context()
    except ModuleNotFoundError:
        return Finding("OpenGL", "lacking", "see extra view")
    except GraphicsError as error:
        return Finding("OpenGL", "lacking", str(error))
    try:
        info = context.info
        renderer, version = info["GL_RENDERER"], context.version_code
    finally:
        context.release()
    is_software = any(word in renderer.lower() for word in ("llvmpipe", "softpipe", "swiftshader"))
    detail = f"{renderer}, GL {version / 100:.1f}"
    if is_software:
        return Finding(
            "OpenGL", "good", f"{detail}, in software", "a graphics driver would draw faster"
        )
    return Finding("OpenGL", "good", detail)


def _inference(load: Callable[[str], Any]) -> Finding:
    try:
        onnxruntime = load("onnxruntime")
    except Exception:
        return Finding("ONNX Runtime", "lacking", "see extra view")
    providers = ", ".join(onnxruntime.get_available_providers())
    return Finding("ONNX Runtime", "good", f"{onnxruntime.__version__}, {providers}")


def _display(is_there: bool) -> Finding:
    if is_there:
        return Finding("display", "good", "one is named, not tried")
    fix = "set DISPLAY or WAYLAND_DISPLAY, or use --headless" if sys.platform == "linux" else ""
    return Finding("display", "lacking", "none", fix)


def _avatars() -> Finding:
    names = [path.stem for path in shipped_avatar_files()]
    if names:
        return Finding("avatars", "good", ", ".join(names))
    return Finding("avatars", "lacking", "none ship with this build", "--avatar FILE")
