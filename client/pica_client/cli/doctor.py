"""What this machine can do, and the fix for each lack. Runs on the base install."""

import importlib
import os
import shlex
import sys
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from pica_client.output import say
from pica_client.ui.display import has_display
from pica_client.user_folders import open_to_others
from pica_command.extras import install_line, modules_by_extra
from pica_command.table import COMMANDS, refuse
from pica_core.avatar.shipped import shipped_avatar_files
from pica_core.errors import GraphicsError

Level = Literal["ready", "missing"]

NEEDS: Final = {
    "view": ("OpenGL", "ONNX Runtime", "display", "avatars"),
    "demo": ("OpenGL", "ONNX Runtime", "video", "avatars"),
    "send": ("avatars",),
    "capture person": ("OpenGL",),
    "capture rig": ("OpenGL",),
    "bench": ("OpenGL", "ONNX Runtime", "avatars"),
}
"""What commands, or families of them, need besides their extras."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorOptions:
    """Options of `pica doctor`."""

    command: tuple[str, ...] = field(default=(), kw_only=False)
    """A command, such as view or capture rig: only what it needs is examined, and the exit status
    is 1 if it cannot work."""


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
        fix = f"; to mend it: {self.fix}" if self.fix else ""
        return f"{self.level:8} {self.subject}: {self.detail}{fix}"


def doctor(options: DoctorOptions) -> dict[str, Any]:
    """Say what this machine can do, and how to mend what it lacks.

    With the name of a command, say whether that one can work here.
    """
    asked = " ".join(options.command)
    findings = examine(wanted=_wanted(asked) if asked else None, has_display=has_display)
    for finding in findings:
        say(finding.line)
    lacking = [finding.subject for finding in findings if finding.level == "missing"]
    if asked and lacking:
        say(f"pica {asked} cannot work here: {', '.join(lacking)} missing")
    elif asked:
        say(f"pica {asked} can work here")
    return {
        "ok": not (asked and lacking),
        "findings": [asdict(finding) for finding in findings],
    }


def load_module(name: str) -> Any:
    """Import a module by name; ONNX Runtime comes with its telemetry off, as everywhere."""
    if name == "onnxruntime":
        return importlib.import_module("pica_client.decode.onnx_runtime").onnxruntime
    return importlib.import_module(name)


def examine(
    load: Callable[[str], Any] = load_module,
    *,
    has_display: Callable[[], bool],
    wanted: Collection[str] | None = None,
) -> list[Finding]:
    """Look at every extra, every device and the avatars.

    Args:
        has_display: Whether a window can be expected to open.
        wanted: Subjects to look at; None is all of them.
    """
    looks: dict[str, Callable[[], Finding]] = {
        f"extra {extra}": partial(_extra, extra, modules, load)
        for extra, modules in modules_by_extra().items()
        if modules and extra != "all"
    }
    looks |= {
        "OpenGL": lambda: _graphics(load),
        "ONNX Runtime": lambda: _inference(load),
        "CUDA": lambda: _training_device(load),
        "video": lambda: _video(load),
        "display": lambda: _display(has_display()),
        "avatars": _avatars,
        "privacy": _privacy,
    }
    return [look() for subject, look in looks.items() if wanted is None or subject in wanted]


def _wanted(asked: str) -> set[str]:
    """Subjects that a command, or a family of them, needs.

    Raises:
        UsageError: There is none of that name.
    """
    chosen = [name for name in COMMANDS if name == asked or name.startswith(f"{asked} ")]
    if not chosen:
        refuse(asked.split())
    wanted = {f"extra {extra}" for name in chosen for extra in COMMANDS[name].extras}
    for name in chosen:
        wanted.update(NEEDS.get(name, NEEDS.get(name.partition(" ")[0], ())))
    return wanted


def _privacy() -> Finding:
    """Look whether others on this machine can read what is this user's alone."""
    secret = ("_KEYS", "TOKEN_FILE", "SECRET_FILE", "TLS_KEY")
    named = [Path(v) for k, v in os.environ.items() if k.startswith("PICA_") and k.endswith(secret)]
    found = [shlex.quote(str(path)) for path in open_to_others(named)]
    if found:
        detail = f"others on this machine can look into {', '.join(found)}"
        return Finding("privacy", "missing", detail, f"chmod go= {' '.join(found)}")
    return Finding("privacy", "ready", "cache, preferences and secrets are for you alone")


def _extra(extra: str, modules: tuple[str, ...], load: Callable[[str], Any]) -> Finding:
    lacking, is_silent = [], False
    for module in modules:
        try:
            load(module)
        except Exception as error:  # a broken install fails in ways of its own
            is_absent = isinstance(error, ModuleNotFoundError)
            if module == "soundcard" and not is_absent:  # it connects when it is imported
                is_silent = True
            else:
                lacking.append(module if is_absent else f"{module} ({error})")
    if lacking:
        return Finding(f"extra {extra}", "missing", f"no {', '.join(lacking)}", install_line(extra))
    if is_silent:
        detail = "installed, but no sound system answers"
        return Finding(f"extra {extra}", "missing", detail, "start PulseAudio or PipeWire")
    return Finding(f"extra {extra}", "ready", "installed")


def _graphics(load: Callable[[str], Any]) -> Finding:
    try:
        gl = load("pica_core.gl")
        context = gl.create_context()
    except ModuleNotFoundError:
        return Finding("OpenGL", "missing", "moderngl is not installed", install_line("view"))
    except GraphicsError as error:
        return Finding("OpenGL", "missing", str(error))
    try:
        info = context.info
        renderer, version = info["GL_RENDERER"], context.version_code
        can_decode = load("pica_client.render.gpu_decoder").draws_floats(context)
    finally:
        context.release()
    detail = f"{renderer}, GL {version / 100:.1f}"
    if gl.is_software(renderer):
        detail += ", in software: a graphics driver would draw faster"
    elif not can_decode:
        detail += ", without 32-bit float targets: faces are decoded on the processor"
    return Finding("OpenGL", "ready", detail)


def _inference(load: Callable[[str], Any]) -> Finding:
    try:
        onnxruntime = load("onnxruntime")
    except Exception:
        return Finding("ONNX Runtime", "missing", "not installed", install_line("view"))
    providers = ", ".join(onnxruntime.get_available_providers())
    return Finding("ONNX Runtime", "ready", f"{onnxruntime.__version__}, {providers}")


def _training_device(load: Callable[[str], Any]) -> Finding:
    try:
        torch = load("torch")
    except Exception:
        return Finding("CUDA", "missing", "PyTorch is not installed", install_line("train"))
    about = f"PyTorch {torch.__version__}"
    if torch.cuda.is_available():
        return Finding("CUDA", "ready", f"{about}, {torch.cuda.get_device_name()}")
    return Finding("CUDA", "missing", f"{about} finds none and trains on the CPU")


def _video(load: Callable[[str], Any]) -> Finding:
    try:
        has_h264 = "libx264" in load("av").codecs_available
    except Exception:
        return Finding("video", "missing", "no recordings to MP4", install_line("video"))
    return Finding("video", "ready", f"recordings in {'H.264' if has_h264 else 'MPEG-4'}")


def _display(is_there: bool) -> Finding:
    if is_there:
        return Finding("display", "ready", "the environment names one; it was not tried")
    fix = "set DISPLAY or WAYLAND_DISPLAY, or use --headless" if sys.platform == "linux" else ""
    return Finding("display", "missing", "none", fix)


def _avatars() -> Finding:
    names = [path.stem for path in shipped_avatar_files()]
    if names:
        return Finding("avatars", "ready", ", ".join(names))
    return Finding("avatars", "missing", "none ship with this build", "--avatar FILE")
