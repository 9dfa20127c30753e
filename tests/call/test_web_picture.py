"""A page and a viewer in the same call show the same picture of the same moment."""

import asyncio
import base64
import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from helpers.chromium import Tab, chromium
from helpers.senders import LoadedAvatars, make_senders, run_senders
from pica_client.call.call import Call
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool
from pica_client.endpoint import Receiver
from pica_client.local_call.processes import Children
from pica_client.publish import SenderConfig
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.seats import FreeShares
from pica_client.schedule.scheduler import Scheduler
from pica_client.sources.source import make_performance
from pica_client.transport.connect import LinkConfig
from pica_client.ui.avatar_presenter import AvatarPresenter
from pica_client.ui.widgets import BAR_PT, EDGE_PT
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.avatar.file import Avatar, avatar_id, load_avatar, shipped_avatar_files
from pica_core.gl import create_context
from pica_core.types import Image as Picture

pytestmark = pytest.mark.realtime

SIZE = (960, 540)
NAMES = ("Ada", "Ben", "Cyd")
BAR_PX = BAR_PT + EDGE_PT
"""What both keep free below for their buttons."""
HELD_S = 3.0
"""When all stop in the middle of what they say; streams go on."""


class _Held:
    """A performance that stops."""

    def __init__(self, seed: int) -> None:
        self._performance = make_performance("talk", seed=seed, start_s=2.3 * seed)

    def frame_at(self, time_s: float) -> ExpressionFrame:
        frame = self._performance.frame_at(min(time_s, HELD_S))
        return replace(frame, captured_us=round(time_s * 1e6))


@contextmanager
def _people(url: str) -> Iterator[dict[str, Avatar]]:
    """Three senders; the avatars of all, by their ids."""
    avatars = [(avatar_id(path), load_avatar(path)) for path in shipped_avatar_files()[:3]]
    links = [LinkConfig(url=url, room="r", name=name) for name in NAMES]
    sources = [_Held(seed) for seed in range(3)]
    senders = make_senders(links, avatars, config=SenderConfig(), sources=sources)
    thread = threading.Thread(target=asyncio.run, args=[run_senders(senders)])
    thread.start()
    yield dict(avatars)
    for sender in senders:
        sender.stop()
    thread.join()


def _shown_by_page(tab: Tab, url: str) -> Picture:
    """What the page draws once all is still, without names and buttons."""
    width, height = SIZE
    tab.send(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=False,
    )
    tab.open(url.replace("ws://", "http://") + "/r")
    tab.until("document.getElementById('join')?.hidden === false", 20)
    tab.value("document.getElementById('name').value = 'Web'; begin.click()")
    tab.until("document.querySelectorAll('#labels button').length === 3", 30)
    tab.until("document.querySelectorAll('#labels .faceless').length === 0", 60)
    tab.value("for (const each of [labels, bar, notice]) each.style.visibility = 'hidden'")
    shown: list[bytes] = []
    while len(shown) < 2 or shown[-1] != shown[-2]:
        time.sleep(2)
        shown.append(base64.b64decode(tab.send("Page.captureScreenshot", format="png")["data"]))
        assert len(shown) < 20
    return np.asarray(Image.open(io.BytesIO(shown[-1])).convert("RGB"))


def _shown_by_viewer(url: str, avatars: dict[str, Avatar]) -> Picture:
    call = Call(LoadedAvatars(avatars))
    context = create_context()
    with (
        Receiver(LinkConfig(url=url, room="r", name="Eve"), call),
        Renderer(context, SIZE, RenderOptions(fade_busts=True)) as renderer,
        DecodePool(OnnxDecoder) as pool,
    ):
        presenter = AvatarPresenter(call, renderer, pool, Scheduler())
        begun_s, is_ready_s = time.monotonic(), np.inf
        while (now := time.monotonic()) < is_ready_s + 3:
            assert now < begun_s + 60
            scene = presenter.arrange(now, SIZE, None, FreeShares(bottom=BAR_PX / SIZE[1]))
            presenter.decide(scene, (scene.camera,), 0.02)
            pool.wait_idle(1.0)
            presenter.collect(now)
            scene = presenter.dressed(scene)
            renderer.draw(scene.placements, scene.camera, room=scene.room)
            if len(scene.faces) == len(NAMES) and presenter.is_ready(scene):
                is_ready_s = min(is_ready_s, now)
            time.sleep(0.03)
        image = renderer.read_image().copy()
    context.release()
    return image


def test_a_live_call_looks_as_in_the_viewer() -> None:
    with Children() as children, chromium() as tab:
        _, url = children.start_relay()
        with _people(url) as avatars:
            page = _shown_by_page(tab, url)
            tab.value("leave.click()")
            viewer = _shown_by_viewer(url, avatars)
    apart = np.abs(page.astype(int) - viewer)
    assert apart.mean() < 1  # 0.3 here; 3 is what was promised
