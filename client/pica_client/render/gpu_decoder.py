"""Latents to maps by shaders: all heads of a frame at once, into the textures that they are drawn
with.

    decoder = GpuDecoder(context, renderer.map_targets)
    if decoder.add("peer-1", avatar): ...               # else such avatars are decoded elsewhere
    decoder.submit("peer-1", request)
    results = decoder.take_results()                    # draws: the maps are there afterwards

Each step of the expression decoder is one draw, whoever is decoded: heads lie one below the other
in its images, and an avatar's numbers are a layer of a table (`gpu_tables`). A level below the
full one leaves the steps that all share at its size. Vertices are sums over the directions of their
regions. Only the last step, into a head's own textures, is one draw a head and map. A head and
frame take one kilobyte of upload.

Everything belongs to the thread of the context.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from pica_client.decode.request import DecodeChoice, DecodedMaps, DecodeRequest, DecodeResult, Parts
from pica_client.errors import OptionError
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_program import build_program, clamp, set_values
from pica_client.render.gpu_tables import (
    LAST_SHADERS,
    TABLE_COLUMNS,
    VECTOR,
    Pass,
    Plan,
    basis_of,
    lay_out,
    sheet_of,
)
from pica_client.render.renderer import Renderer
from pica_client.render.shader_source import compose
from pica_client.system import Closing
from pica_core.avatar.file import Avatar
from pica_core.gl import freeing, is_software
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.types import Array

HEAD_TEXELS = NUM_LATENT // VECTOR + 1
"""What goes to the GPU for each head and frame, texels of 16 bytes."""
MAX_BATCH = 32
"""Heads that are decoded together; more are decoded in several turns."""
UNIT_ROWS, UNIT_HEADS, UNIT_TABLE, UNIT_PLACES, UNIT_MEAN, UNIT_BASIS = 0, 4, 5, 6, 7, 8
_UNITS = {
    **{f"phase{number}": number for number in range(4)},
    **{"rows": UNIT_ROWS, "heads": UNIT_HEADS, "table": UNIT_TABLE},
    **{"places": UNIT_PLACES, "mean": UNIT_MEAN, "basis": UNIT_BASIS},
}
RGB8_SNORM = 0x8F96
"""What GL calls three signed bytes from -1 to 1; moderngl would take unsigned ones."""

Targets = tuple[moderngl.Framebuffer | None, moderngl.Framebuffer]
"""Where a head's vertices and its expression map are drawn; None for maps that stay."""
FindTargets = Callable[[str, int, Parts], Targets | None]
"""The targets of a slot, a level and parts; None of a slot that is gone."""


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
    return GpuDecoder(context, renderer.map_targets, clock)


@dataclass(slots=True, eq=False)
class _Slot:
    """One head."""

    avatar: Avatar
    bank: _Bank
    request: DecodeRequest | None = None
    submitted_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """One head of a batch."""

    slot: str
    avatar: Avatar
    request: DecodeRequest
    submitted_s: float
    level: int
    targets: Targets


class GpuDecoder(Closing):
    """Decodes the newest latent of every head by shaders.

    Args:
        find_targets: See `Renderer.map_targets`.
        clock: Seconds, monotonic.

    Attributes:
        bytes_uploaded: What went to the GPU for all heads so far.
    """

    def __init__(
        self,
        context: moderngl.Context,
        find_targets: FindTargets,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.bytes_uploaded = 0
        self._context = context
        self._find_targets = find_targets
        self._clock = clock
        self._slots: dict[str, _Slot] = {}
        self._banks: list[_Bank] = []
        self._gpu_clock: DrawClock[int] = DrawClock(context)
        self._s_per_multiply_add = 0.0  # until it is known

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
            plan, tables = laid_out
            bank = next((each for each in self._banks if each.plan == plan), None)
            if bank is None:
                bank = _Bank(self._context, plan)
                self._banks.append(bank)
            bank.add(avatar, tables)
        self._slots[slot] = _Slot(avatar, bank)
        return True

    def remove(self, slot: str) -> None:
        """Forget a slot; an unknown one is no error."""
        gone = self._slots.pop(slot, None)
        if gone and all(entry.avatar is not gone.avatar for entry in self._slots.values()):
            with freeing(self._context):
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

        What GL state moderngl can set it sets itself; afterwards the framebuffer is one of the
        heads' maps, and flags and texture units 0 to 9 are as it used them.
        """
        results, jobs, work = [], [], 0
        for slot, entry in list(self._slots.items()):
            request, entry.request = entry.request, None
            if request is None:
                continue
            level = request.level or entry.avatar.spec.map_size
            if problem := _problem(entry.avatar, request, level):
                results.append(DecodeResult(slot, None, problem))
                self.remove(slot)
                continue
            targets = self._find_targets(slot, level, request.parts)
            if targets is not None:
                work += entry.bank.plan.multiply_adds(level)
                job = _Job(slot, entry.avatar, request, entry.submitted_s, level, targets)
                jobs.append((entry.bank, job))
        if not jobs:
            return results
        started_s = self._clock()
        self._context.enable_only(moderngl.NOTHING)
        self._context.clear_samplers(0, UNIT_BASIS + 1)
        with self._gpu_clock.around(work):
            for bank in self._banks:
                own = [job for other, job in jobs if other is bank]
                own.sort(key=lambda job: -job.level)
                for start in range(0, len(own), MAX_BATCH):
                    self.bytes_uploaded += bank.decode(own[start : start + MAX_BATCH])
        for done, seconds in self._gpu_clock.take():
            self._s_per_multiply_add = seconds / done
        for bank, job in jobs:
            decode_s = self._s_per_multiply_add * bank.plan.multiply_adds(job.level)
            maps = DecodedMaps(None, None, job.level)
            times_s = (job.submitted_s, started_s, started_s + decode_s)
            captured_us, parts = job.request.captured_us, job.request.parts
            results.append(
                DecodeResult(job.slot, maps, None, captured_us, *times_s, job.level, parts)
            )
        return results

    def close(self) -> None:
        """Forget all slots and programs."""
        with freeing(self._context):
            self._slots.clear()
            self._banks.clear()


def _problem(avatar: Avatar, request: DecodeRequest, level: int) -> str:
    """What is wrong with a request; nothing if it is sound."""
    if request.latent.shape != LATENT_SHAPE or request.view_direction.shape != (3,):
        return f"latent is of shape {request.latent.shape}; {LATENT_SHAPE} is needed"
    if level not in avatar.levels:
        return f"level is {level}; this avatar has {', '.join(map(str, avatar.levels))}"
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """What the GPU holds of one avatar."""

    layer: int
    tables: tuple[Array, Array]
    basis: moderngl.Texture
    sheets: dict[int, tuple[moderngl.Texture, moderngl.Texture]]
    """Places and mean of each level."""


class _Bank:
    """Avatars of one plan: their numbers, the programs that use them, and the images between.

    Raises:
        ShaderError: The driver refuses our shaders.
    """

    def __init__(self, context: moderngl.Context, plan: Plan) -> None:
        self.plan = plan
        self._context = context
        self._entries: dict[Avatar, _Entry] = {}
        self._tables: list[moderngl.TextureArray] = []
        self._capacity = 0
        self._numbers = np.zeros((MAX_BATCH, HEAD_TEXELS, VECTOR), np.float32)
        self._trunk = [_Step(context, step) for step in plan.trunk]
        self._exits = {level: _Step(context, last) for level, (_, last) in plan.exits.items()}
        self._vertices = [_Step(context, step) for step in plan.vertices]
        self._gather, self._sheet = (_screen(context, name, {}) for name in LAST_SHADERS)

    def __contains__(self, avatar: Avatar) -> bool:
        return avatar in self._entries

    def add(self, avatar: Avatar, tables: tuple[Array, Array]) -> None:
        """Put an avatar's numbers on the GPU."""
        used = {entry.layer for entry in self._entries.values()}
        layer = next(number for number in range(len(used) + 1) if number not in used)
        basis = basis_of(avatar)
        stored = ("ni1", RGB8_SNORM) if basis.itemsize == 1 else ("f4", None)
        sheets = {}
        for level in avatar.levels:
            places, mean = sheet_of(avatar, level)
            sheets[level] = self._texture(places, "u2"), self._texture(mean, "f4")
        entry = _Entry(layer, tables, self._texture(basis, *stored), sheets)
        self._entries[avatar] = entry
        if not self._tables or any(
            layer >= texture.layers or len(table) > texture.height
            for texture, table in zip(self._tables, tables, strict=True)
        ):
            self._make_tables()
        else:
            self._write(entry)

    def remove(self, avatar: Avatar) -> None:
        """Forget an avatar; its layer is for the next one."""
        self._entries.pop(avatar, None)

    def decode(self, jobs: Sequence[_Job]) -> int:
        """Decode a batch, those of the full level first; how many bytes were uploaded."""
        self._reserve(len(jobs))
        numbers = self._numbers[: len(jobs)]
        for row, job in zip(numbers, jobs, strict=True):
            row[:-1] = job.request.latent.reshape(-1, VECTOR)
            row[-1] = (*job.request.view_direction, self._entries[job.avatar].layer)
        self._heads.write(numbers, viewport=(0, 0, HEAD_TEXELS, len(jobs)))
        self._heads.use(UNIT_HEADS)
        self._decode_codes(jobs)
        if any(job.targets[0] for job in jobs):
            self._decode_vertices(jobs)
        return numbers.nbytes

    def _decode_codes(self, jobs: Sequence[_Job]) -> None:
        """Go through the trunk with those who are still in it; others leave at their level."""
        lengths = [self.plan.trunk_length(job.level) for job in jobs]
        for number, step in enumerate(self._trunk):
            step.draw(sum(length > number for length in lengths), self._tables)
            step.bind()
            left = [place for place, length in enumerate(lengths) if length == number + 1]
            if not left:
                continue
            if (last := self._exits.get(jobs[left[0]].level)) is not None:
                last.draw(left[-1] + 1, self._tables)
                last.bind()
            for place in left:
                job = jobs[place]
                job.targets[1].use()
                set_values(self._gather.program, head=place, tile=job.level // 2)
                self._gather.render(moderngl.TRIANGLE_STRIP, vertices=4)
            if left[0] == 0:
                return
            step.bind()

    def _decode_vertices(self, jobs: Sequence[_Job]) -> None:
        self._heads.use(UNIT_ROWS)
        for step in self._vertices:
            step.draw(len(jobs), self._tables)
            step.bind()
        for place, job in enumerate(jobs):
            if job.targets[0] is None:
                continue
            entry = self._entries[job.avatar]
            places, mean = entry.sheets[job.level]
            places.use(UNIT_PLACES)
            mean.use(UNIT_MEAN)
            entry.basis.use(UNIT_BASIS)
            scale_m = job.avatar.manifest.position_scale_m
            set_values(self._sheet.program, head=place, scale_m=scale_m)
            job.targets[0].use()
            self._sheet.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _texture(self, array: Array, dtype: str, form: int | None = None) -> moderngl.Texture:
        rows, columns, components = array.shape
        size, data = (columns, rows), np.ascontiguousarray(array).tobytes()
        made = self._context.texture(
            size, components, data, dtype=dtype, alignment=1, internal_format=form
        )
        return clamp(made, moderngl.NEAREST)

    def _make_tables(self) -> None:
        """Make room for twice as many avatars, and write those that are there."""
        layers = 2 * (1 + max(entry.layer for entry in self._entries.values()))
        with freeing(self._context):
            self._tables = []
            for number, dtype in enumerate(("f2", "f4")):
                rows = max(len(entry.tables[number]) for entry in self._entries.values())
                size = (TABLE_COLUMNS, rows, layers)
                texture = self._context.texture_array(size, VECTOR, dtype=dtype)
                texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
                self._tables.append(texture)
        for entry in self._entries.values():
            self._write(entry)

    def _write(self, entry: _Entry) -> None:
        for texture, table in zip(self._tables, entry.tables, strict=True):
            texture.write(table, viewport=(0, 0, entry.layer, TABLE_COLUMNS, len(table), 1))

    def _reserve(self, count: int) -> None:
        """Make the images between for so many heads."""
        if count <= self._capacity:
            return
        self._capacity = 1 << (count - 1).bit_length()
        with freeing(self._context):
            # Freeing a framebuffer that is bound is an error to moderngl.
            self._context.detect_framebuffer(0).use()
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

    def draw(self, count: int, tables: Sequence[moderngl.TextureArray]) -> None:
        """Draw the first heads, from what is bound."""
        tables[self._pass.table].use(UNIT_TABLE)
        self._target.viewport = (0, 0, self._pass.columns, count * self._pass.rows)
        self._target.use()
        self._screen.render(moderngl.TRIANGLE_STRIP, vertices=4)


def _screen(
    context: moderngl.Context, name: str, defines: Mapping[str, int]
) -> moderngl.VertexArray:
    """A rectangle over a whole target, drawn by a program of its own."""
    texts = {key: str(value) for key, value in defines.items()}
    program = build_program(context, compose("rect.vert"), compose(name, defines=texts))
    set_values(program, rect=(-1.0, -1.0, 1.0, 1.0))
    set_values(program, **{name: unit for name, unit in _UNITS.items() if name in program})
    return context.vertex_array(program, [])


def _image(context: moderngl.Context, columns: int, rows: int) -> moderngl.Texture:
    return clamp(context.texture((columns, rows), VECTOR, dtype="f4"), moderngl.NEAREST)
