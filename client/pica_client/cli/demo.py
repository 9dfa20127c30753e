"""The product's main job on one machine: a relay, senders and a viewer, each a process of its own.

The numbers are of this machine under its present load, over loopback; with software GL most of the
latency is waiting for the picture before.
"""

import json
import time
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import CallProcessError, check_ranges
from pica_client.local_call import local_call
from pica_client.local_call.processes import Child, Children
from pica_client.stats import describe_machine
from pica_client.system import has_display, say, terminate_as_interrupt, writing
from pica_client.ui.options import parse_size
from pica_core.files import replacing

END_TIMEOUT_S = 90.0
"""Time that the viewer has to start, see everybody and write its files, besides the call."""
VIEWER_NAME = "viewer"


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoConfig:
    """What to show and where to put it; the options of `pica demo`."""

    call: Annotated[local_call.LocalCallConfig, Parameter(name="*")] = field(
        default_factory=local_call.LocalCallConfig
    )
    has_voices: Annotated[bool, Parameter(name="voices")] = True
    """Let the senders speak by turns, with the sentences that ship."""
    seconds: float = 20.0
    """How long the call is drawn."""
    headless: bool = False
    """No window, even where there is a display."""
    size: str = "960x540"
    """Columns x rows of the window or picture."""
    out: Path = Path("demo-out")
    """Folder for call.mp4, frame.png and stats.json."""

    def __post_init__(self) -> None:
        check_ranges(self, seconds=(1, 3600))
        parse_size(self.size)


def demo(options: DemoConfig) -> dict[str, Any]:
    """Hold a call on this machine: a relay, simulated senders and a viewer.

    Opens a window if there is a display, else draws into a recording. Writes call.mp4, frame.png
    and stats.json.
    """
    config = replace(options, headless=options.headless or not has_display())
    with terminate_as_interrupt():
        stats = run_demo(config)
    latency = stats["latency_ms"]
    say(
        f"{stats['rendered_peers']} of {stats['peers']} peers drawn at {stats['render_fps']} "
        f"images/s with {stats['gl_renderer']}; source sample to decoded avatar "
        f"p50 {latency['p50']} ms, p99 {latency['p99']} ms; errors: {stats['errors']}"
    )
    say(f"see call.mp4, frame.png and stats.json in {options.out}")
    is_whole = stats["rendered_peers"] == stats["peers"]
    if not is_whole:
        say("not everybody was drawn: give it more --seconds or fewer --peers")
    return {**stats, "ok": is_whole}


def run_demo(config: DemoConfig) -> dict[str, Any]:
    """Hold the call, and write `call.mp4`, `frame.png` and `stats.json`.

    Returns:
        What stands in `stats.json`.

    Raises:
        ClientError: A source, an avatar, the folder or a process is not as it must be.
    """
    film = config.out / "call.mp4"
    with writing(config.out):
        config.out.mkdir(parents=True, exist_ok=True)
        film.unlink(missing_ok=True)
    with closing(AvatarLibrary()) as library, Children() as children:
        stage = local_call.LocalCall(config.call, library, children, has_voices=config.has_voices)
        viewer = children.start("viewer", *_view_arguments(config, stage))
        _watch(config, stage, viewer)
        shown = viewer.result()
        sent = stage.finish()
        stats = _stats(config, stage, shown, sent)
    stats_file = config.out / "stats.json"
    with writing(stats_file), replacing(stats_file) as unfinished:
        unfinished.write_text(json.dumps(stats, indent=2) + "\n")
    return stats


def _view_arguments(config: DemoConfig, stage: local_call.LocalCall) -> list[str]:
    arguments = ["view", "--url", stage.url, "--room", local_call.ROOM, "--name", VIEWER_NAME]
    arguments += ["--size", config.size, "--seconds", f"{config.seconds:g}"]
    arguments += ["--expect", str(config.call.peers)]
    arguments += ["--record", str(config.out / "call.mp4")]
    arguments += ["--png", str(config.out / "frame.png"), *stage.secret_arguments]
    if config.call.avatar is not None:
        arguments += ["--avatar", config.call.avatar]
    if config.headless:
        # There is no listener: the voices are played, and measured, without a sound.
        arguments += ["--speaker", "none", "--headless"]
    return arguments


def _watch(config: DemoConfig, stage: local_call.LocalCall, viewer: Child) -> None:
    """Wait for the viewer to end, looking after all processes meanwhile."""
    end_s = time.monotonic() + config.seconds + END_TIMEOUT_S
    say(f"a call of {len(stage.worn)} for {config.seconds:g} s")
    while viewer.exit_code is None:
        stage.check()
        if time.monotonic() > end_s:
            raise CallProcessError(f"the viewer did not end in time: {viewer.last_words()}")
        time.sleep(local_call.CHECK_INTERVAL_S)


def _stats(
    config: DemoConfig,
    stage: local_call.LocalCall,
    shown: dict[str, Any],
    sent: dict[str, dict[str, Any]],
) -> dict[str, Any]:
    received = shown["received"]
    parts = {name: shown[f"{name}_ms"] for name in ("decode_wait", "decode", "upload", "draw")}
    rates = {peer["name"]: peer["latents_per_s"] for peer in received["peers"]}
    errors = shown["errors"] + sum(result["errors"] for result in sent.values())
    return {
        "peers": config.call.peers,
        "rendered_peers": shown["rendered_peers"],
        "seconds": shown["seconds"],
        "frames_rendered": shown["frames_rendered"],
        "render_fps": shown["render_fps"],
        "latents_per_s": {name: rates.get(name, 0.0) for name in stage.worn},
        "decodes_per_s": round(sum(shown["decodes"].values()) / max(shown["seconds"], 0.01), 2),
        "bitrate_bps": local_call.bitrates(sent),
        "latency_ms": {**shown["latency_ms"], "parts": parts},
        "concealed": received["concealed"],
        "seal": received["seal"],
        "voice": shown["voice"],
        "errors": errors,
        "source": config.call.source or "shipped performances",
        "size": config.size,
        "gl_renderer": shown["gl_renderer"],
        "machine": describe_machine(),
    }
