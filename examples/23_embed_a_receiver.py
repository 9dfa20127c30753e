"""Show a call in your own program: its own GL context and loop, a picture for two eyes.

You learn which parts a program puts together, and what it does each frame. The receiver runs on a
thread of its own and the decoders on theirs; all that touches the GPU is called by the program, on
the thread of its context. Relay and senders stand in for a real call.
"""

import sys
import time
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from PIL import Image

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Children
from pica_client.render.gpu_decoder import choose_decoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.views import stereo_cameras
from pica_client.schedule.scheduler import Scheduler
from pica_client.transport.connect import LinkConfig
from pica_client.ui.avatar_presenter import AvatarPresenter

NAMES = {"Ada": "amara", "Ben": "elias"}
CONTEXT: dict[str, Any] = {"standalone": True, "backend": "egl", "require": 330}  # or a window's
EYE, EYE_DISTANCE_M = (480, 480), 0.063
SIZE = (2 * EYE[0], EYE[1])
FPS, SETTLE_S = 30, 1.5


def watch(context: moderngl.Context, screen: moderngl.Framebuffer, url: str) -> int:
    """Draw the call on the program's screen until all are seen; says how often."""
    library = AvatarLibrary()
    call = Call(library)
    with (
        Receiver(LinkConfig(url=url, name="headset"), call) as receiver,
        DecodePool(OnnxDecoder) as pool,
        Renderer(context, SIZE, RenderOptions(fade_busts=True)) as renderer,
    ):
        shaders = choose_decoder("auto", context, renderer)  # with a GPU, instead of the pool
        presenter = AvatarPresenter(call, renderer, pool, Scheduler(), shaders=shaders)
        num_frames, ready_s = 0, float("inf")
        while (now := time.monotonic()) < ready_s + SETTLE_S:
            receiver.check()  # raises what went wrong on its thread
            scene = presenter.arrange(now, EYE)
            away_m = float(np.linalg.norm(scene.plan.target_m - scene.camera.centre_m))
            eyes = stereo_cameras(scene.camera, EYE_DISTANCE_M, away_m)
            presenter.decide(scene, eyes, 0.8 / FPS)
            presenter.collect(now)
            scene = presenter.dressed(scene)
            renderer.draw(scene.placements, *eyes, room=scene.room)
            renderer.present(screen)
            # Whatever the program draws over it comes here; it sets its own GL state.
            num_frames += 1
            if len(presenter.seen) == len(NAMES):
                ready_s = min(ready_s, now)
            time.sleep(max(now + 1 / FPS - time.monotonic(), 0.0))  # a headset's clock
        print("seen:", ", ".join(f"{face.name} ({face.status})" for face in scene.faces))
    library.close()
    return num_frames


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
    out.mkdir(parents=True, exist_ok=True)
    context = moderngl.create_context(**CONTEXT)
    screen = context.simple_framebuffer(SIZE)  # a window's, or a headset's
    with Children() as children:
        _, url = children.start_relay()
        for name, avatar in NAMES.items():
            who = ("--url", url, "--name", name, "--avatar", avatar)
            children.start(name, "send", *who, "--source", "performance:talk")
        num_frames = watch(context, screen, url)
    picture = np.frombuffer(screen.read(), np.uint8).reshape(SIZE[1], SIZE[0], 3)
    Image.fromarray(picture[::-1]).save(out / "two-eyes.png")
    print(f"drew {num_frames} frames of two eyes by {context.info['GL_RENDERER']}")
    context.release()


main()
