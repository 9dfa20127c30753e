"""A page of pictures for the person: the input, the head that was fitted to it, how far they
differ, and what was guessed. One HTML file that needs nothing beside it."""

import base64
import html
import io
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.camera import Camera, aimed_camera
from pica_core.capture.dataset.multiface import MATERIALS, write_aside
from pica_core.capture.me.face import OwnHead, chart_uv, head_faces
from pica_core.capture.me.pictured import Fitted
from pica_core.capture.me.register import Registered
from pica_core.capture.me.scan import MeshViews, Scan
from pica_core.capture.person.choices import read_model
from pica_core.capture.stage.subject import View
from pica_core.types import ByteArray, FloatArray

AZIMUTHS, SIDE = (0.0, 40.0, 80.0), 400
MOST_SHOWN = 12
WORST_M = 0.003
"""Distance that is drawn as red as any."""
SIZED = "The size is that of your pupillary distance."
USUAL = "Size cannot be seen in photos: it is an average one (--pupillary-distance-mm gives yours)."
TEMPLATE = """<!doctype html><meta charset="utf-8"><title>{title}</title>
<style>body{{font:16px sans-serif;margin:2em;max-width:1260px}}td{{padding:2px}}</style>
<h1>{title}</h1><p>{told}</p><table><tr><th>{columns}</tr>
{rows}</table><h2>Guessed, since it was not seen</h2><ul>{guessed}</ul>
"""


def report_scan(path: Path, found: Registered, head: OwnHead) -> None:
    """Write the page of a scan.

    Raises:
        CaptureError: It cannot be written.
    """
    scan, mine, theirs = found.scan, _as_scan(head), []
    pairs = ((scan, found.face.pose.undo(scan.points)), (mine, mine.points))
    for each, points in pairs:
        with MeshViews(each) as views:
            views.move(points)
            theirs.append([views.draw(_camera(azimuth)) for azimuth in AZIMUTHS])
    shown = [[one.image, two.image, _distance(one, two)] for one, two in zip(*theirs, strict=True)]
    told = (
        f"{scan.path.name}: {len(scan.faces):,} triangles. The skin of the face lies "
        f"{1000 * found.off_m:.2f} mm off the scan in the median."
    )
    _write(path, head, told, "scan<th>fitted head<th>distance, 0 to 3 mm", shown)


def report_photos(path: Path, found: Fitted, head: OwnHead) -> None:
    """Write the page of photos: each, the head over it, and the head alone.

    Raises:
        CaptureError: It cannot be written.
    """
    shown, drawn, model = [], _as_scan(head), read_model()
    order = np.concatenate([head_faces(model, part).ravel() for part in ("skin", "eye")])
    with MeshViews(drawn) as views:
        for k, photo in enumerate(found.photos[:MOST_SHOWN]):
            camera = found.solution.cameras[k]
            views.move(found.solution.shape(model, k)[order])
            view = views.draw(camera)
            low, high = photo.landmarks[:, :2].min(0), photo.landmarks[:, :2].max(0)
            side = 0.8 * float(max(high - low))
            left, top = np.maximum((low + high) / 2 - side, 0).astype(int)
            right, bottom = ((low + high) / 2 + side).astype(int)
            over = np.where((view.depth_m > 0)[..., None], view.image, photo.image)
            mixed = (0.5 * over + 0.5 * photo.image).astype(np.uint8)
            shown.append(
                [
                    np.asarray(Image.fromarray(each[top:bottom, left:right]).resize((SIDE, SIDE)))
                    for each in (photo.image, mixed, over)
                ]
            )
    told = (
        f"{len(found.photos)} photos; landmarks lie {found.off_px:.1f} px off in the median. "
        f"{SIZED if found.is_sized else USUAL}"
    )
    _write(path, head, told, "photo<th>both<th>fitted head", shown)


def _write(
    path: Path, head: OwnHead, told: str, columns: str, shown: list[list[ByteArray]]
) -> None:
    rows = "\n".join(
        "<tr>" + "".join(f'<td><img src="{_inline(image)}">' for image in images) + "</tr>"
        for images in shown
    )
    guessed = "".join(f"<li>{html.escape(each)}" for each in head.guessed)
    page = TEMPLATE.format(
        title=f"Your own head, from {head.source}", told=html.escape(told), columns=columns,
        rows=rows, guessed=guessed,
    )  # fmt: skip
    write_aside(path, page.encode())


def _camera(azimuth: float) -> Camera:
    return aimed_camera("", azimuth, 0.0, "head", width=SIDE, height=SIDE)


def _as_scan(head: OwnHead) -> Scan:
    """Skin and eyes of a fitted head, each triangle with corners of its own."""
    model = read_model()
    mean = model.mean
    skin, eyes = head_faces(model, "skin"), head_faces(model, "eye")
    placed = chart_uv(model)[mean.uv_faces[mean.part == MATERIALS.index("skin")]].reshape(-1, 2)
    count, more = skin.size, eyes.size
    tint = np.ones((count + more, 3))
    middle = np.array([0.31, 0.2])
    row, column = (middle[::-1] * len(head.texture)).astype(int)
    tint[count:] = 220 / np.maximum(head.texture[row, column, :3], 1)
    return Scan(
        path=Path("head"),
        points=head.rest_m[np.concatenate([skin, eyes]).ravel()],
        faces=np.arange(count + more, dtype=np.int32).reshape(-1, 3),
        uv=np.concatenate([placed, np.tile(middle, (more, 1))]),
        image=np.ascontiguousarray(head.texture[..., :3]),
        colours=tint,
        has_colour=True,
        has_loose_image=False,
    )


def _distance(one: View, two: View) -> ByteArray:
    """How far two views differ in depth: from green over yellow to red, grey where one is empty."""
    apart: FloatArray = np.abs(one.depth_m - two.depth_m) / np.float32(WORST_M)
    both = (one.depth_m > 0) & (two.depth_m > 0)
    share = np.clip(apart, 0, 1)[..., None]
    colour = np.concatenate([np.clip(2 * share, 0, 1), np.clip(2 - 2 * share, 0, 1), 0 * share], 2)
    return np.where(both[..., None], 230 * colour, 92).astype(np.uint8)


def _inline(image: ByteArray) -> str:
    stored = io.BytesIO()
    Image.fromarray(image).save(stored, "JPEG", quality=88)
    return "data:image/jpeg;base64," + base64.b64encode(stored.getvalue()).decode()
