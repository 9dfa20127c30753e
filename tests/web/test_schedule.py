"""The page spends a frame as the viewer does, frame after frame."""

import numpy as np
import pytest

from helpers.page import Page
from pica_client.decode.request import DecodeResult
from pica_client.render.room import lens_of
from pica_client.render.scene import head_matrix
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler, requests_of
from pica_core.avatar.file import load_avatar, shipped_avatar_files
from pica_core.camera import look_at
from pica_core.types import LATENT_SHAPE

pytestmark = pytest.mark.unit
PLAY = "../../../tests/web/play"
AVATARS = [load_avatar(path) for path in shipped_avatar_files()[:5]]
SIZE = (1280, 720)


@pytest.mark.parametrize("seed", range(1, 13))  # 0 turns a head by a threshold, but for rounding
def test_plans_are_those_of_the_viewer(page: Page, seed: int) -> None:
    rng = np.random.default_rng(seed)
    heads = [Head(slot=str(index), avatar=avatar) for index, avatar in enumerate(AVATARS)]
    camera = look_at(
        centre_m=[0, 0, float(rng.uniform(0.5, 4))],
        target_m=[0, 0, 0],
        vertical_fov=0.56,
        width=SIZE[0],
        height=SIZE[1],
    )
    scheduler, frames, expected, now = Scheduler(), [], [], 5.0
    places = rng.normal(0, [0.5, 0.1, 0.4], (len(heads), 3))
    latents = np.zeros(len(heads), np.float32)
    for _ in range(40):
        now += float(rng.choice([1 / 60, 1 / 20, 0.3]))
        budget = float(rng.choice([0.004, 0.012, 0.03, 0.1]))
        people = []
        places += rng.normal(0, 0.01, places.shape)
        for index, head in enumerate(heads):
            turn = rng.normal(0, 0.1, 3) * (rng.random() < 0.3)
            head.world_from_head = head_matrix(np.eye(4), turn, places[index])
            latents[index] += np.float32(rng.choice([0.0, 0.01, 0.2]))
            head.latent = np.full(LATENT_SHAPE, latents[index], np.float32)
            head.is_listening = bool(rng.random() < 0.6)
            people.append(
                {
                    "matrix": head.world_from_head.ravel(),
                    "latent": float(latents[index]),
                    "isListening": head.is_listening,
                }
            )
        costs = scheduler.costs
        known = {
            "draw": [costs.draw.frame_s, costs.draw.triangle_s, costs.draw.pixel_s],
            "decodes": {
                parts: {n: costs.decode_s(heads[0].model, n, parts) for n in AVATARS[0].levels}
                for parts in ("expression", "both")
            },
        }
        plan = scheduler.plan_view(heads, [camera], SIZE, budget, now)
        for head, request in requests_of(heads, now):
            took_s = float(rng.uniform(0.5, 2) * 1e-3 * request.level / 64)
            result = DecodeResult(head.slot, None, None, finished_s=took_s, parts=request.parts)
            costs.observe_decode(head.model, request.level, result.parts, took_s)
        triangles = float(rng.integers(1e4, 2e5))
        costs.observe_draw(triangles, plan.shaded_px, float(rng.uniform(0.004, 0.04)))
        frames.append({"now": now, "budget": budget, "people": people, **known})
        expected.append(
            {
                "costS": plan.cost_s,
                "isShort": plan.is_short,
                "shadedPx": plan.shaded_px,
                "sights": [list(head.sight)[:2] for head in heads],
                "choices": [list(head.choice or ()) for head in heads],
            }
        )
    avatars = [
        {
            "triangles": [len(avatar.level_faces(level)) for level in avatar.levels],
            "low": avatar.manifest.bounds_min_m,
            "high": avatar.manifest.bounds_max_m,
        }
        for avatar in AVATARS
    ]
    x, y, z = camera.rotation
    seen = {
        "centre": camera.centre_m,
        "axes": [x.tolist(), (-y).tolist(), z.tolist()],
        "lens": lens_of(camera),
        "width": SIZE[0],
        "height": SIZE[1],
    }
    found = page.call(PLAY, "schedule", avatars, seen, frames)
    for frame, (got, wanted) in enumerate(zip(found, expected, strict=True)):
        assert got["choices"] == wanted["choices"], frame
        assert got["isShort"] == wanted["isShort"], frame
        for name in ("costS", "shadedPx", "sights"):
            np.testing.assert_allclose(
                got[name], wanted[name], rtol=1e-4, err_msg=f"{frame} {name}"
            )
