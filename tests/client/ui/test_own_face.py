"""One's own face in the corner of the picture, drawn off the screen."""

import time

import numpy as np
import pytest

from pica_client.call.call import Reflection
from pica_client.publish import Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.ui.viewer import SelfView
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.codec.latent_stream import LatentEncoder
from pica_core.gl import create_context

pytestmark = pytest.mark.render

AVATAR = load_avatar(shipped_avatar_files()[0])


def send(reflection: Reflection, number: int) -> None:
    """Send one frame of a face that talks."""
    frame = open_source("performance:talk").frame_at(number / 30)
    coded = LatentEncoder().encode(
        frame.arkit, frame.rotation, frame.translation_m, number * 33_333
    )
    assert coded is not None
    reflection.receive(coded, number * 33_333, now=number / 30)


def test_ones_own_face_appears_once_it_is_sent_in_the_size_that_is_asked_for() -> None:
    source = open_source("performance:talk")
    track = Publisher(SenderConfig(), source, AVATAR, "5" * 64).track
    reflection = Reflection(AVATAR, track)
    context = create_context()
    view = SelfView(context, reflection)
    try:
        assert view.draw(0.0, 60) is None
        for number in range(30):
            send(reflection, number)
        texture, deadline_s = None, time.monotonic() + 20
        at = 1.0
        while texture is None and time.monotonic() < deadline_s:
            at += 0.1
            texture = view.draw(at, 60)
            time.sleep(0.01)
        assert texture is not None
        assert texture.size == (80, 60)
        image = np.frombuffer(texture.read(), np.uint8).reshape(60, 80, 4)
        assert image[20:40, 30:50, :3].std() > 5  # a face, and no empty room
        assert view.draw(at + 1.0, 90) is not None
        assert view.draw(at + 1.0, 90).size == (120, 90)  # type: ignore[union-attr]
    finally:
        view.close()
        context.release()
