"""What is done once on a machine: its examination, a room secret, the networks of a webcam.

It runs on the base install.
"""

import importlib
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from pica_client.e2ee.secret import RoomSecret, save_secret
from pica_client.system import has_display, say
from pica_command.table import install_line, modules_by_extra
from pica_core.errors import GraphicsError


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorOptions:
    """Options of `pica doctor`; there are none."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the examination."""

    subject: str
    level: Literal["ready", "missing"]
    detail: str
    fix: str = ""

    @property
    def line(self) -> str:
        """The finding as people read it."""
        fix = f"; to fix it: {self.fix}" if self.fix else ""
        return f"{self.level:8} {self.subject}: {self.detail}{fix}"


def doctor(options: DoctorOptions) -> dict[str, Any]:
    """Report what this machine can do, and how to fix what it lacks."""
    findings = examine(has_display=has_display())
    for finding in findings:
        say(finding.line)
    return {"findings": [asdict(finding) for finding in findings]}


def load_module(name: str) -> Any:
    """Import a module by name; ONNX Runtime comes with its telemetry off, as everywhere."""
    if name == "onnxruntime":
        return importlib.import_module("pica_client.decode.decoder").onnxruntime
    return importlib.import_module(name)


def examine(load: Callable[[str], Any] = load_module, *, has_display: bool) -> list[Finding]:
    """Look at every extra and every device.

    Args:
        has_display: A window can be expected to open.
    """
    extras = {name: found for name, found in modules_by_extra().items() if found and name != "all"}
    return [
        *(_extra(name, modules, load) for name, modules in extras.items()),
        _graphics(load),
        _training_device(load),
        _display(has_display),
    ]


def _extra(extra: str, modules: tuple[str, ...], load: Callable[[str], Any]) -> Finding:
    subject, lacking, is_silent = f"extra {extra}", [], False
    for module in modules:
        try:
            load(module)
        except ModuleNotFoundError:
            lacking.append(module)
        except Exception as error:  # a broken install fails in ways of its own
            if module == "soundcard":  # it connects when it is imported
                is_silent = True
            else:
                lacking.append(f"{module} ({error})")
    if lacking:
        return Finding(subject, "missing", f"no {', '.join(lacking)}", install_line(extra))
    if is_silent:
        detail = "installed, but no sound system answers"
        return Finding(subject, "missing", detail, "start PulseAudio or PipeWire")
    return Finding(subject, "ready", "installed")


def _graphics(load: Callable[[str], Any]) -> Finding:
    try:
        gl = load("pica_core.gl")
        context = gl.create_context()
    except ModuleNotFoundError:
        return Finding("OpenGL", "missing", "moderngl is not installed", install_line("view"))
    except GraphicsError as error:
        return Finding("OpenGL", "missing", str(error))
    renderer, version = context.info["GL_RENDERER"], context.version_code
    draws_floats = load("pica_client.render.gpu_decoder").draws_floats(context)
    context.release()
    detail = f"{renderer}, GL {version / 100:.1f}"
    if gl.is_software(renderer):
        detail += ", in software: a graphics driver would draw faster"
    elif not draws_floats:
        detail += ", no 32-bit float targets: the processor decodes faces"
    return Finding("OpenGL", "ready", detail)


def _training_device(load: Callable[[str], Any]) -> Finding:
    try:
        torch = load("torch")
    except Exception:
        return Finding("CUDA", "missing", "PyTorch is not installed", install_line("train"))
    about = f"PyTorch {torch.__version__}"
    if torch.cuda.is_available():
        return Finding("CUDA", "ready", f"{about}, {torch.cuda.get_device_name()}")
    return Finding("CUDA", "missing", f"{about} finds none and trains on the CPU")


def _display(is_there: bool) -> Finding:
    if is_there:
        return Finding("display", "ready", "the environment names one; it was not tried")
    fix = "set DISPLAY or WAYLAND_DISPLAY, or use --headless" if sys.platform == "linux" else ""
    return Finding("display", "missing", "none", fix)


@dataclass(frozen=True, kw_only=True, slots=True)
class SecretOptions:
    """Options of `pica secret`."""

    file: Path = field(kw_only=False)
    """File to write; it must not be there yet."""


def secret(options: SecretOptions) -> dict[str, Any]:
    """Make a room secret for calls that the relay cannot look into.

    Give the file to everybody in the call, on a way that is not the relay's, and name it with
    --secret-file. Nothing of it is shown here.
    """
    save_secret(options.file, RoomSecret.new())
    say(f"wrote {options.file}; hand it to the others, and use it with --secret-file")
    return {"file": str(options.file)}


@dataclass(frozen=True, kw_only=True, slots=True)
class WebcamOptions:
    """Options of `pica webcam setup`."""

    source: Annotated[str, Parameter(name="from")] = ""
    """Where the face landmarker lies: an address, or a face_landmarker.task; by default where its
    authors publish it."""


def webcam_setup(options: WebcamOptions) -> dict[str, Any]:
    """Fetch the networks that find a face in a picture, 3.8 MB, and check them.

    It is MediaPipe's face landmarker (Apache 2.0), for webcams and for avatars of oneself. Nothing
    else is ever fetched for these, and no picture leaves this program.
    """
    # Only here: they need packages of their own.
    from pica_core.face_networks import SHA256, URL, install

    source = options.source or URL
    say(f"from {source}")
    path = install(source)
    say(f"stored in {path}; now: pica track webcam")
    return {"path": str(path), "sha256": SHA256}
