"""Latents to maps by shaders: all heads of a frame at once, into textures that they share.

    decoder = GpuDecoder(context, renderer)
    if decoder.add("peer-1", avatar): ...               # else such avatars are decoded elsewhere
    decoder.submit("peer-1", request)
    results = decoder.take_results()                    # draws: the maps are shown afterwards

Each step is one draw for all who are decoded: heads lie one below the other in its images, and an
avatar's numbers are a layer of each array (`gpu_tables`). A level below the full one leaves the
steps that all share at its size. Vertices are sums over the directions of their regions. The last
step is one draw for each map, straight to where the renderer has it. A head and frame take one
kilobyte of upload.

Everything belongs to the thread of the context.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import moderngl
import numpy as np

from pica_client.decode.request import DecodeChoice, DecodedMaps, DecodeRequest, DecodeResult
from pica_client.errors import OptionError
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_program import build_program, clamp, compose, set_values
from pica_client.render.gpu_tables import GATHER, SHEET, VECTOR, Pass, Plan, lay_out
from pica_client.render.renderer import Renderer
from pica_client.system import Closing
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import MAP_SIZE
from pica_core.gl import freeing, is_software
from pica_core.types import LATENT_SHAPE, NUM_LATENT, Array

HEAD_TEXELS = NUM_LATENT // VECTOR + 2
"""What goes to the GPU for each head and frame, texels of 16 bytes."""
MAX_BATCH = 32
"""Heads that are decoded together; more are decoded in several turns."""
NUM_TIMED = 8
"""Batches of which the fastest says what a head takes on the GPU."""
UNIT_ROWS, UNIT_HEADS, UNIT_TABLE, UNIT_PLACES, UNIT_MEAN, UNIT_BASIS = 0, 4, 5, 6, 7, 8
_UNITS = {
    **{f"phase{number}": number for number in range(4)},
    **{"rows": UNIT_ROWS, "heads": UNIT_HEADS, "table": UNIT_TABLE},
    **{"places": UNIT_PLACES, "mean": UNIT_MEAN, "basis": UNIT_BASIS},
}
_DTYPES = {"float16": "f2", "float32": "f4", "uint16": "u2", "uint8": "f1"}


def draws_floats(context: moderngl.Context) -> bool:
    """Return True if the driver draws into four textures of 32-bit floats at once, which decoding
    in shaders needs."""
    with freeing(context):
        images = [_image(context, 4, 4) for _ in range(4)]
        try:
            context.framebuffer(images)
        except moderngl.Error:
            return False
    return True


def choose_decoder(
    choice: DecodeChoice,
    context: moderngl.Context,
    renderer: Renderer,
    clock: Callable[[], float] = time.monotonic,
) -> GpuDecoder | None:
    """A decoder in shaders if that is the choice, or best on this machine; else None.

    Raises:
        OptionError: It is the choice, and the driver cannot.
    """
    can = draws_floats(context)
    if choice == "gpu" and not can:
        raise OptionError(
            f"decode is gpu, which needs a driver that draws 32-bit floats; "
            f"{renderer.gl_renderer} does not: take cpu"
        )
    if choice == "cpu" or not can or (choice == "auto" and is_software(renderer.gl_renderer)):
        return None
    return GpuDecoder(context, renderer, clock)


@dataclass(slots=True, eq=False)
class _Slot:
    """One head."""

    avatar: Avatar
    bank: _Bank
    request: DecodeRequest | None = None
    submitted_s: float = 0.0


class _Job(NamedTuple):
    """One head of a batch."""

    slot: str
    entry: _Slot
    request: DecodeRequest
    level: int
    vertices: moderngl.Framebuffer | None
    codes: moderngl.Framebuffer


class GpuDecoder(Closing):
    """Decodes the newest latent of every head by shaders.

    Args:
        renderer: Holds the maps of its slots.
        clock: Seconds, monotonic.
    """

    def __init__(
        self,
        context: moderngl.Context,
        renderer: Renderer,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._context = context
        self._map_targets = renderer.map_targets
        self._clock = clock
        self._slots: dict[str, _Slot] = {}
        self._banks: list[_Bank] = []
        self._gpu_clock: DrawClock[int] = DrawClock(context)
        # That clock runs on while the GPU waits for this thread: the least of a few is its own.
        self._head_s: deque[float] = deque(maxlen=NUM_TIMED)

    def add(self, slot: str, avatar: Avatar) -> bool:
        """Prepare a slot for an avatar; return False for one that shaders do not evaluate.

        Raises:
            ShaderError: The driver refuses our shaders.
        """
        self.remove(slot)
        bank = next((each for each in self._banks if avatar in each), None)
        if bank is None:
            laid_out = lay_out(avatar)
            if laid_out is None:
                return False
            plan, arrays = laid_out
            bank = next((each for each in self._banks if each.plan == plan), None)
            if bank is None:
                bank = _Bank(self._context, plan)
                self._banks.append(bank)
            bank.add(avatar, arrays)
        self._slots[slot] = _Slot(avatar, bank)
        return True

    def remove(self, slot: str) -> None:
        """Forget a slot; an unknown one is no error."""
        gone = self._slots.pop(slot, None)
        if gone is None:
            return
        if all(entry.avatar is not gone.avatar for entry in self._slots.values()):
            gone.bank.remove(gone.avatar)

    def submit(self, slot: str, request: DecodeRequest) -> None:
        """Ask for a decode; takes the place of one that still waits, and widens to its parts.
        Unknown slots ignore it."""
        entry = self._slots.get(slot)
        if entry is not None:
            entry.request = request.widened_by(entry.request) if entry.request else request
            entry.submitted_s = self._clock()

    def take_results(self) -> list[DecodeResult]:
        """Decode what was asked for since the last call.

        What GL state moderngl can set it sets itself; afterwards the framebuffer is one of its own,
        and flags and texture units 0 to 8 are as it used them.
        """
        results, jobs = [], []
        for slot, entry in list(self._slots.items()):
            request, entry.request = entry.request, None
            if request is None:
                continue
            if request.latent.shape != LATENT_SHAPE:
                problem = f"latent is of shape {request.latent.shape}; {LATENT_SHAPE} is needed"
                results.append(DecodeResult(slot, None, problem))
                self.remove(slot)
                continue
            level = request.level or MAP_SIZE
            targets = self._map_targets(slot, level, both=request.parts == "both")
            if targets is not None:
                jobs.append(_Job(slot, entry, request, level, *targets))
        if jobs:
            results += self._decode(jobs)
        return results

    def _decode(self, jobs: list[_Job]) -> list[DecodeResult]:
        started_s = self._clock()
        self._context.enable_only(moderngl.NOTHING)
        self._context.wireframe = False
        self._context.clear_samplers(0, UNIT_BASIS + 1)
        jobs.sort(key=lambda job: -job.level)
        with self._gpu_clock.around(len(jobs)):
            for bank in self._banks:
                own = [job for job in jobs if job.entry.bank is bank]
                for start in range(0, len(own), MAX_BATCH):
                    bank.decode(own[start : start + MAX_BATCH])
        for num_heads, seconds in self._gpu_clock.take():
            self._head_s.append(seconds / num_heads)
        finished_s = started_s + min(self._head_s, default=0.0)
        return [
            DecodeResult(
                job.slot,
                DecodedMaps(None, None, job.level),
                None,
                captured_us=job.request.captured_us,
                submitted_s=job.entry.submitted_s,
                started_s=started_s,
                finished_s=finished_s,
                parts=job.request.parts,
            )
            for job in jobs
        ]

    def close(self) -> None:
        """Forget all slots and programs."""
        with freeing(self._context):
            self._context.detect_framebuffer(0).use()  # freeing one that is bound is an error
            self._slots.clear()
            self._banks.clear()


class _Bank:
    """Avatars of one plan: their numbers, the programs that use them, and the images between.

    Raises:
        ShaderError: The driver refuses our shaders.
    """

    def __init__(self, context: moderngl.Context, plan: Plan) -> None:
        self.plan = plan
        self._context = context
        self._arrays: dict[Avatar, dict[str, Array]] = {}
        self._layers: dict[Avatar, int] = {}
        self._textures: dict[str, moderngl.TextureArray] = {}
        self._capacity = 0
        self._numbers = np.zeros((MAX_BATCH, HEAD_TEXELS, VECTOR), np.float32)
        self._trunk = [_Step(context, step) for step in plan.trunk]
        self._exits = {level: _Step(context, last) for level, (_, last) in plan.exits.items()}
        self._vertices = [_Step(context, step) for step in plan.vertices]
        self._full = _screen(context, plan.full.shader, plan.full.defines)
        self._gather, self._sheet = (_screen(context, name, {}) for name in (GATHER, SHEET))

    def __contains__(self, avatar: Avatar) -> bool:
        return avatar in self._layers

    def add(self, avatar: Avatar, arrays: dict[str, Array]) -> None:
        """Put an avatar's numbers on the GPU; makes room for twice as many if there is none."""
        used = set(self._layers.values())
        layer = next(number for number in range(len(used) + 1) if number not in used)
        self._arrays[avatar], self._layers[avatar] = arrays, layer
        wanted = [avatar]
        if not self._textures or layer >= self._textures["half"].layers:
            wanted = list(self._layers)
            with freeing(self._context):
                self._textures = {
                    name: self._layered(array, 2 * (layer + 1)) for name, array in arrays.items()
                }
        for each in wanted:
            for name, array in self._arrays[each].items():
                texture, place = self._textures[name], (0, 0, self._layers[each])
                viewport = (*place, texture.width, texture.height, 1)
                texture.write(np.ascontiguousarray(array), viewport=viewport)

    def remove(self, avatar: Avatar) -> None:
        """Forget an avatar; its layer is for the next one."""
        del self._arrays[avatar], self._layers[avatar]

    def decode(self, jobs: Sequence[_Job]) -> None:
        """Decode a batch, those of the full level first."""
        self._reserve(len(jobs))
        numbers = self._numbers[: len(jobs)]
        for row, job in zip(numbers, jobs, strict=True):
            avatar = job.entry.avatar
            row[:-2] = job.request.latent.reshape(-1, VECTOR)
            row[-2] = (*job.request.view_direction, self._layers[avatar])
            row[-1, 0] = avatar.manifest.position_scale_m
        self._heads.write(numbers, viewport=(0, 0, HEAD_TEXELS, len(jobs)))
        self._heads.use(UNIT_HEADS)
        self._decode_codes(jobs)
        if any(job.vertices for job in jobs):
            self._decode_vertices(jobs)

    def _decode_codes(self, jobs: Sequence[_Job]) -> None:
        """Go through the trunk with those who are still in it; others leave at their level."""
        lengths = [self.plan.trunk_length(job.level) for job in jobs]
        for number, step in enumerate(self._trunk):
            step.draw(sum(length > number for length in lengths), self._textures)
            step.bind()
            left = [place for place, length in enumerate(lengths) if length == number + 1]
            if not left:
                continue
            last = self._exits.get(jobs[left[0]].level)
            if last is not None:
                last.draw(left[-1] + 1, self._textures)
                last.bind()
            for place in left:
                _draw_map(self._gather if last else self._full, jobs[place].codes, place)
            if left[0] == 0:
                return
            step.bind()

    def _decode_vertices(self, jobs: Sequence[_Job]) -> None:
        self._heads.use(UNIT_ROWS)
        for step in self._vertices:
            step.draw(len(jobs), self._textures)
            step.bind()
        self._textures["basis"].use(UNIT_BASIS)
        for number, job in enumerate(jobs):
            if job.vertices is not None:
                self._textures[f"places {job.level}"].use(UNIT_PLACES)
                self._textures[f"mean {job.level}"].use(UNIT_MEAN)
                _draw_map(self._sheet, job.vertices, number)

    def _layered(self, array: Array, layers: int) -> moderngl.TextureArray:
        rows, columns, components = array.shape
        size, dtype = (columns, rows, layers), _DTYPES[array.dtype.name]
        texture = self._context.texture_array(size, components, dtype=dtype)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def _reserve(self, count: int) -> None:
        """Make the images between for so many heads."""
        if count <= self._capacity:
            return
        self._capacity = 1 << (count - 1).bit_length()
        with freeing(self._context):
            self._context.detect_framebuffer(0).use()  # freeing one that is bound is an error
            self._heads = _image(self._context, HEAD_TEXELS, self._capacity)
            for step in (*self._trunk, *self._exits.values(), *self._vertices):
                step.make_images(self._capacity)


class _Step:
    """One pass over all heads, and the images that it draws."""

    def __init__(self, context: moderngl.Context, step: Pass) -> None:
        self._context, self._pass = context, step
        self._screen = _screen(context, step.shader, step.defines)
        self._images: list[moderngl.Texture] = []

    def make_images(self, capacity: int) -> None:
        """Make what it draws into, for so many heads."""
        size = self._pass.columns, capacity * self._pass.rows
        self._images = [_image(self._context, *size) for _ in range(self._pass.num_images)]
        self._target = self._context.framebuffer(self._images)

    def bind(self) -> None:
        """Let others read what it drew."""
        for unit, image in enumerate(self._images):
            image.use(unit)

    def draw(self, count: int, arrays: Mapping[str, moderngl.TextureArray]) -> None:
        """Draw the first heads, from what is bound."""
        arrays[self._pass.table].use(UNIT_TABLE)
        self._target.viewport = (0, 0, self._pass.columns, count * self._pass.rows)
        self._target.use()
        self._screen.render(moderngl.TRIANGLE_STRIP, vertices=4)


def _draw_map(screen: moderngl.VertexArray, target: moderngl.Framebuffer, head: int) -> None:
    """Draw a map of a head of the batch."""
    target.use()
    set_values(screen.program, head=head)
    screen.render(moderngl.TRIANGLE_STRIP, vertices=4)


def _screen(
    context: moderngl.Context, name: str, defines: Mapping[str, int]
) -> moderngl.VertexArray:
    """A rectangle over a whole target, drawn by a program of its own."""
    program = build_program(context, compose("rect.vert"), compose(name, defines=defines))
    set_values(program, **{name: unit for name, unit in _UNITS.items() if name in program})
    return context.vertex_array(program, [])


def _image(context: moderngl.Context, columns: int, rows: int) -> moderngl.Texture:
    return clamp(context.texture((columns, rows), VECTOR, dtype="f4"), moderngl.NEAREST)
