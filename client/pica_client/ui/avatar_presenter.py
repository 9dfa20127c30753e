"""The faces of a call on their way to the picture: who is ready, what is decoded, how it came out.

Between a source of faces, a pool of decoders and a renderer; knows no window and no loop:

    presenter = AvatarPresenter(source, renderer, pool, Scheduler())
    scene = presenter.arrange(now, renderer.size)       # who sits where
    presenter.decide(scene, (scene.camera,), budget_s)  # what is decoded from now on
    presenter.collect(now)                              # what has been decoded goes to the GPU
    scene = presenter.dressed(scene)                    # how finely each is drawn
    renderer.draw(scene.placements, scene.camera, room=scene.room)

Decoding runs beside drawing, so a frame shows the latents of the frame before it. A peer whose
avatar is missing or broken sits there as a placeholder with the reason; the others do not notice.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

from pica_client.call.call import Call
from pica_client.call.speaking import JawReader, SpeakingMeter
from pica_client.call.status import FaceState
from pica_client.decode.pool import DecodePool
from pica_client.errors import ShaderError
from pica_client.render import views
from pica_client.render.gpu_decoder import GpuDecoder
from pica_client.render.renderer import Renderer
from pica_client.render.room import Room
from pica_client.render.scene import Placement, head_matrix
from pica_client.render.seats import SHOULDERS_M, FreeShares, SeatPlan, plan_seats
from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import LISTENER_S, Plan, Scheduler, requests_of
from pica_client.stats import MAX_SAMPLES, Summary, summarise_ms
from pica_client.ui.state import ViewState
from pica_core.avatar.bust import bust_of
from pica_core.avatar.manifest import ViewSpan
from pica_core.camera import Camera
from pica_core.errors import AvatarFileError
from pica_core.types import Float64Array

FADE_OF_STATUS = {"waiting": 0.6, "stale": 0.8, "away": 0.4}
FADE_S = 0.5
"""How long a face takes to fade all the way, and to come back (chosen: seen, and not a flash)."""
GLOW_STEPS = 4
"""Between no glow around a speaker and a bright one."""
SETTLE_S = 0.15
"""In which seats and camera go most of the way to where they should be when a person comes, goes or
is pinned (chosen: seen as a movement, and over soon)."""
AUDIBLE_LEVEL = 45
"""Decibels below full scale: a louder voice speaks (chosen: a quiet room is below 60)."""
VOICE_HOLD_S = 0.4
"""A shorter pause is one of speech."""
AHEAD_SMOOTHING, MAX_IMAGE_S = 0.05, 0.5
"""Weight of one decoded face in the mean of how long faces take to be seen, and the longest that is
believed of an image."""
MEASURED = ("decode", "decode_wait", "upload", "draw", "latency")


class Meter:
    """Durations of a call, in seconds, for the report."""

    def __init__(self) -> None:
        self._samples = {name: deque[float](maxlen=MAX_SAMPLES) for name in MEASURED}

    def add(self, name: str, duration_s: float) -> None:
        """Take one more duration of one of `MEASURED`."""
        self._samples[name].append(duration_s)

    def clear(self) -> None:
        """Forget all: what came before was warming up."""
        for samples in self._samples.values():
            samples.clear()

    def summaries(self) -> dict[str, Summary]:
        """Percentiles of all, milliseconds, as ``draw_ms`` and so on."""
        return {f"{name}_ms": summarise_ms(samples) for name, samples in self._samples.items()}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CallScene:
    """One frame before it is decoded and drawn."""

    now: float
    faces: list[FaceState]
    placements: list[Placement]
    """Where their heads are, in the order of the faces."""
    camera: Camera
    plan: SeatPlan
    limits: views.OrbitLimits
    """How far the view may turn."""
    room: Room
    """What is behind them."""


@dataclass(slots=True, eq=False)
class _Peer:
    """All that the drawing side keeps of one peer."""

    avatar_id: str
    head: Head | None = None
    """Its avatar before the cameras; None until that is there."""
    is_shaded: bool = False
    """Whether it is decoded in shaders."""
    shoulders_m: float = SHOULDERS_M
    span: ViewSpan = views.USUAL_SPAN
    """The directions that its avatar may be seen from."""
    problem: str = ""
    """Why there is a placeholder instead of the avatar."""
    captured_us: int = 0
    """Sender's clock at the newest sample that was decoded."""
    num_decoded: int = 0
    num_drawn: int = 0
    """Those that the last image had."""
    turn: int = 0
    """In which of its turns its face was taken: a listener keeps it until the next comes."""
    is_awaited: bool = False
    """Whether a decode has been asked for and is not there."""
    drawn: Placement | None = None
    """As it was drawn last."""
    fade: float = 0.0
    jaw: JawReader | None = None
    speaking: SpeakingMeter = field(default_factory=SpeakingMeter)
    heard_s: float | None = None
    """When its voice was last loud, on our clock; None: it sends none."""
    glow_share: float = 0.0
    on_leave: ExitStack = field(default_factory=ExitStack)
    """Gives back what the decode pool and the renderer hold of it."""

    @property
    def is_asked_for(self) -> bool:
        """Whether its maps show the face that was taken, or will; else a newer one is better."""
        head = self.head
        if head is None or head.asked is None:
            return False
        return head.asked.latent is head.latent or head.latent_change == 0

    def is_speaking(self, now: float) -> bool:
        """Whether its voice says that it speaks, or its jaw where there is no voice."""
        if self.heard_s is None:
            return self.speaking.is_speaking(now)
        return now - self.heard_s < VOICE_HOLD_S

    def glow(self, now: float, step: float) -> float:
        """How bright the glow around it is, in a few steps: each draws the room again."""
        goal = float(self.is_speaking(now))
        self.glow_share = _towards(goal, self.glow_share, step)
        return math.ceil(GLOW_STEPS * self.glow_share) / GLOW_STEPS


class AvatarPresenter:
    """Keeps the seats of a call.

    Args:
        pool: Where they are decoded; its slots are peer ids.
        shaders: Where those are decoded whom it takes; None: all in the pool.
        scheduler: Says what is decoded, and how finely it is drawn.
        levels: How loud each is who sends a voice, by peer id; see `voice.opus.level_of`.
        clock: Seconds, monotonic; see `viewer.Viewer`.

    Attributes:
        seen: Peers of whom a face was shown.
        num_errors: Peers who became placeholders.
    """

    def __init__(
        self,
        source: Call,
        renderer: Renderer,
        pool: DecodePool,
        scheduler: Scheduler,
        *,
        shaders: GpuDecoder | None = None,
        meter: Meter | None = None,
        levels: Callable[[], Mapping[str, int]] = dict,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.num_errors = 0
        self._source = source
        self._renderer = renderer
        self._pool = pool
        self._shaders = shaders
        self._scheduler = scheduler
        self._meter = meter or Meter()
        self._levels = levels
        self._clock = clock
        self._peers: dict[str, _Peer] = {}
        self.seen: set[str] = set()
        self._arranged_s: float | None = None
        self._image_s = self._ahead_s = 0.0  # between two images; until a face is seen
        self._is_short = False  # whether drawing everybody takes longer than it may
        self._seats: dict[str, Float64Array] = {}
        self._plan: SeatPlan | None = None
        self._size = (0, 0)

    def arrange(
        self,
        now: float,
        size: tuple[int, int],
        wanted: ViewState | None = None,
        free: FreeShares | None = None,
    ) -> CallScene:
        """Return the participants, their seats and the camera for a picture of this size; prepare
        their avatars."""
        wanted = wanted or ViewState()
        since_s = math.inf if self._arranged_s is None else max(now - self._arranged_s, 0.0)
        self._image_s = min(since_s, MAX_IMAGE_S)
        # Listeners take turns, so that images cost alike.
        turns = {
            peer_id: math.floor(now / LISTENER_S + number / len(self._peers))
            for number, peer_id in enumerate(self._peers)
        }
        resting = {
            peer_id
            for peer_id, entry in self._peers.items()
            if turns[peer_id] == entry.turn and self._is_waiting(entry, now) and entry.is_asked_for
        }
        faces = self._source.faces(now, self._ahead_s, resting)
        width, height = size
        places = [face.place for face in faces]
        for absent in self._peers.keys() - {face.peer_id for face in faces}:
            self._peers.pop(absent).on_leave.close()
        entries = [self._make_ready(face) for face in faces]
        plan = plan_seats(
            wanted.layout,
            len(faces),
            width / height,
            pinned=places.index(wanted.pinned) if wanted.pinned in places else None,
            free=free,
            shoulders_m=max((entry.shoulders_m for entry in entries), default=SHOULDERS_M),
        )
        limits = views.orbit_limits(plan, tuple(entry.span for entry in entries))
        self._arranged_s, step = now, since_s / FADE_S
        plan = self._settled(plan, [face.peer_id for face in faces], size, since_s)
        placements, levels = [], self._levels()
        for face, entry, seat in zip(faces, entries, plan.seats, strict=True):
            entry.turn = turns.get(face.peer_id, 0)
            entry.fade = _towards(FADE_OF_STATUS.get(face.status, 0.0), entry.fade, step)
            if face.latent is not None and entry.jaw is not None and face.status == "live":
                entry.speaking.receive(entry.jaw.jaw_open(face.latent), now)
            if face.peer_id in levels:
                is_loud = levels[face.peer_id] < AUDIBLE_LEVEL
                entry.heard_s = now if is_loud else entry.heard_s or -math.inf
            placements.append(
                Placement(
                    slot=face.peer_id,
                    world_from_head=head_matrix(seat, face.rotation, face.translation_m),
                    fade=entry.fade,
                )
            )
        camera = views.plan_camera(plan, wanted.orbit, width, height, limits)
        room = Room(
            seats_m=plan.places_m, speaking=tuple(entry.glow(now, step) for entry in entries)
        )
        return CallScene(
            now=now,
            faces=faces,
            placements=placements,
            camera=camera,
            plan=plan,
            limits=limits,
            room=room,
        )

    def decide(self, scene: CallScene, cameras: Sequence[Camera], budget_s: float) -> Plan:
        """Plan a frame: hand what is to be decoded to the pool, and say what is wanted of streams.

        Args:
            cameras: From where it will be drawn: one, or two eyes.
            budget_s: What decoding and drawing it may take, seconds.
        """
        heads = []
        for face, placement in zip(scene.faces, scene.placements, strict=True):
            peer = self._peers[face.peer_id]
            if face.latent is None or peer.head is None or peer.problem:
                continue
            head = peer.head
            head.world_from_head, head.latent = placement.world_from_head, face.latent
            head.captured_us = face.captured_us
            head.is_listening = not peer.is_speaking(scene.now)
            heads.append(head)
        size = (cameras[0].width, cameras[0].height)
        plan = self._scheduler.plan_view(heads, cameras, size, budget_s, scene.now)
        self._is_short = plan.is_short
        for head, request in requests_of(heads, scene.now):
            self._decoder_of(self._peers[head.slot]).submit(head.slot, request)
            self._peers[head.slot].is_awaited = True
        for slot, choice in plan.choices.items():
            self._source.subscribe(slot, choice.every, scene.now)
        return plan

    def collect(self, now: float) -> None:
        """Upload what has been decoded, decode in shaders, and note what could not be decoded."""
        results = self._pool.take_results()
        if self._shaders is not None:
            results += self._shaders.take_results()
        for result in results:
            entry = self._peers.get(result.slot)
            if entry is None or entry.head is None:
                continue
            entry.is_awaited = False
            if result.maps is None:
                self._renderer.add_placeholder(result.slot)
                self._give_up(entry, result.error or "cannot be decoded")
                continue
            begin_s = self._clock()
            maps = result.maps
            self._renderer.update_maps(result.slot, maps.position_map, maps.expression_map)
            upload_s = self._clock() - begin_s
            self._scheduler.note_decoded(entry.head, result, upload_s)
            ahead_s = max(now - result.submitted_s, 0.0) + self._image_s
            self._ahead_s += AHEAD_SMOOTHING * (min(ahead_s, MAX_IMAGE_S) - self._ahead_s)
            self._meter.add("upload", upload_s)
            self._meter.add("decode", result.decode_s)
            self._meter.add("decode_wait", result.waited_s)
            if result.captured_us > entry.captured_us:  # a newly shown sample, not a turned view
                entry.captured_us = result.captured_us
                self._meter.add("latency", result.finished_s - result.captured_us * 1e-6)
            entry.num_decoded += 1
            self.seen.add(result.slot)

    def dressed(self, scene: CallScene) -> CallScene:
        """The scene as its plan wants it drawn."""
        dressed = []
        for placement in scene.placements:
            entry = self._peers[placement.slot]
            if entry.head is not None:
                placement = entry.head.dressed(placement)
            before = entry.drawn
            if before is not None and self._is_waiting(entry, scene.now):
                if entry.is_awaited or not entry.is_asked_for:
                    # Its pose waits for its face: it is drawn once for both.
                    placement = replace(placement, world_from_head=before.world_from_head)
                if (
                    entry.num_drawn == entry.num_decoded
                    and (placement.world_from_head == before.world_from_head).all()
                ):
                    # Nor is it drawn again for another resolution alone.
                    placement = replace(placement, scale=before.scale)
            entry.drawn, entry.num_drawn = placement, entry.num_decoded
            dressed.append(placement)
        return replace(scene, placements=dressed)

    def is_ready(self, scene: CallScene) -> bool:
        """Whether everybody with a face who can be seen has maps, or will not get any."""
        for face in scene.faces:
            entry = self._peers[face.peer_id]
            is_unseen = entry.head is not None and not entry.head.sight.is_visible
            if face.latent is not None and not (entry.num_decoded or entry.problem or is_unseen):
                return False
        return True

    @property
    def problems(self) -> dict[str, str]:
        """Why peers are drawn as placeholders, by peer id."""
        return {peer_id: entry.problem for peer_id, entry in self._peers.items() if entry.problem}

    def speaking(self, now: float) -> set[str]:
        """Those who speak, by peer id."""
        return {peer_id for peer_id, entry in self._peers.items() if entry.is_speaking(now)}

    def num_decoded(self) -> dict[str, int]:
        """Decodes so far, by peer id."""
        return {peer_id: entry.num_decoded for peer_id, entry in self._peers.items()}

    def _is_waiting(self, entry: _Peer, now: float) -> bool:
        """Whether a peer gives way to the speaker."""
        return self._is_short and not entry.is_speaking(now)

    def _settled(
        self, goal: SeatPlan, peer_ids: list[str], size: tuple[int, int], since_s: float
    ) -> SeatPlan:
        """The seats on their way to a plan; at once on a picture of another size."""
        plan = goal
        if self._plan is not None and self._seats and peer_ids and size == self._size:
            whose = zip(peer_ids, goal.seats, strict=True)
            seats = tuple(self._seats.get(peer_id, seat) for peer_id, seat in whose)
            before = replace(self._plan, seats=seats)
            plan = before.nearing(goal, 1 - math.exp(-since_s / SETTLE_S))
        self._plan, self._size = plan, size
        self._seats = dict(zip(peer_ids, plan.seats, strict=True))
        return plan

    def _make_ready(self, face: FaceState) -> _Peer:
        """What is kept of a peer; its avatar is on the GPU and in the pool once that is there."""
        entry = self._peers.get(face.peer_id)
        if entry is not None and entry.avatar_id != face.avatar_id:
            entry.on_leave.close()
            entry = None
        if entry is None:
            entry = self._peers[face.peer_id] = _Peer(face.avatar_id)
            entry.fade = FADE_OF_STATUS.get(face.status, 0.0)
            self._renderer.add_placeholder(face.peer_id)
            entry.on_leave.callback(self._renderer.remove, face.peer_id)
            entry.on_leave.callback(self._pool.remove, face.peer_id)
        if entry.head is None and not entry.problem:
            self._prepare(face.peer_id, entry)
        return entry

    def _prepare(self, peer_id: str, entry: _Peer) -> None:
        try:
            avatar = self._source.avatar(entry.avatar_id)
            if avatar is None:
                return
            self._renderer.add_avatar(peer_id, avatar)
        except (AvatarFileError, ShaderError) as error:
            self._give_up(entry, str(error))
            return
        alike = (each for each in self._peers.values() if each.head and each.head.avatar is avatar)
        shared = next(alike, None)
        entry.head = Head(slot=peer_id, avatar=avatar)
        entry.span = avatar.manifest.view_span
        entry.shoulders_m = shared.shoulders_m if shared else bust_of(avatar).width_m
        entry.jaw = JawReader(avatar)
        if self._shaders is not None and self._shaders.add(peer_id, avatar):
            entry.is_shaded = True
            entry.on_leave.callback(self._shaders.remove, peer_id)
        else:
            self._pool.add(peer_id, avatar)

    def _decoder_of(self, entry: _Peer) -> DecodePool | GpuDecoder:
        return self._shaders if self._shaders is not None and entry.is_shaded else self._pool

    def _give_up(self, entry: _Peer, problem: str) -> None:
        entry.problem = problem
        self.num_errors += 1


def _towards(goal: float, value: float, step: float) -> float:
    """A value that goes to its goal by at most a step."""
    return value + min(max(goal - value, -step), step)
