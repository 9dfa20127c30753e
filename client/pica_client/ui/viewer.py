"""The drawing half of a receiver: faces in, drawn frames out. The loop that owns the GL thread.

    with Viewer(source, ViewOptions(record=Path("call.mp4"))) as viewer:
        viewer.run(seconds=20.0)
        print(viewer.report())

Each frame: take what the user did, let `avatar_presenter` arrange and decode the faces, draw them,
put the surface of `call_surface` over them, show or record.
"""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import moderngl
from imgui_bundle import imgui

from pica_client.call.call import Call, Reflection
from pica_client.call.roster import SELF_ID
from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.pool import DecodePool, num_workers
from pica_client.decode.request import DecodeChoice
from pica_client.endpoint import Receiver
from pica_client.errors import ClientError, OptionError
from pica_client.publish import FaceControls
from pica_client.render.draw_clock import DrawClock
from pica_client.render.gpu_decoder import choose_decoder
from pica_client.render.renderer import DrawStats, Renderer, RenderOptions
from pica_client.render.scene import pick_head
from pica_client.schedule.scheduler import Plan, Scheduler
from pica_client.system import Closing, say
from pica_client.ui.actions import Action, Request, keyboard, mouse, settle
from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene, Meter
from pica_client.ui.call_sound import CallSound
from pica_client.ui.call_surface import CallSurface
from pica_client.ui.camera_output import CameraOutput
from pica_client.ui.options import BUDGET_SHARE, DISPLAY_FPS, SOFTWARE_FPS, ViewOptions, parse_size
from pica_client.ui.overlay import ASPECT, own_face_height
from pica_client.ui.recorder import Recorder, new_path, save_png
from pica_client.ui.state import OwnFaceView, ViewState
from pica_client.ui.window import Surface, Window
from pica_core.files import FOLDERS
from pica_core.gl import create_context, is_software
from pica_protocol import messages

PREPARE_TIMEOUT_S = 5.0
"""How long the first picture waits for five avatars to be loaded; here they take half a second."""
PREPARE_POLL_S = 0.01
RENDER = RenderOptions(fade_busts=True)
DECODE_WAIT_S = 0.008
"""An image waits this long for the faces that it asked for: what comes later is seen an image
later, behind its voice (chosen: half an image of 60 a second)."""
OWN_PERIOD_S = 1 / 15
"""Between two images (chosen: the own face is to be checked, not watched)."""
OWN_BUDGET_S = 0.01
"""What one image may take."""


class Viewer(Closing):
    """Shows the faces of a source in a window or off the screen.

    Args:
        receiver: Says how the call stands, and takes what the user asks of the relay; None: faces
            alone are shown.
        controls: What steers the user's own face; None while none is sent.
        sound: The voices of the call; None: there are none.
        state: What the user wants at first; keys and panels write into it.
        window: To show it in, which stays open afterwards; None draws off the screen.
        clock: Seconds, monotonic; the same clock that stamps `FaceState.captured_us` when sender
            and receiver share a machine (then `report` holds the latency from sample to decoded
            maps; otherwise it means nothing).

    Attributes:
        failures: What could not be written.

    Raises:
        GraphicsError: There is no GL context; names the fix.
        OptionError: The recording cannot be written, or the driver does not decode.
        ModuleNotFoundError: Recording without PyAV.
    """

    def __init__(
        self,
        source: Call,
        options: ViewOptions | None = None,
        *,
        state: ViewState | None = None,
        receiver: Receiver | None = None,
        controls: FaceControls | None = None,
        sound: CallSound | None = None,
        window: Window | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        options = self.options = options or ViewOptions()
        self._clock = clock
        self._controls = controls
        self._sound = sound or CallSound()
        self._receiver = receiver
        self.state = state = state or ViewState()
        state.own_face = "none" if controls is None else "sent"
        state.own_voice = self._sound.own_voice
        self._source = state.source
        self._meter = Meter()
        self._num_frames = 0
        self.failures: list[str] = []
        self._scene: CallScene | None = None
        self.last_draw: DrawStats | None = None
        with ExitStack() as stack:
            self._window = window
            if window is None:
                context = create_context()
                stack.callback(context.release)
                size = parse_size(options.size) if options.size else state.window_size
                self.surface = stack.enter_context(Surface(context))
            else:
                context, size, self.surface = window.context, window.size_px, window.surface
            self._renderer = Renderer(context, size, RENDER)
            is_slow = is_software(self._renderer.gl_renderer)
            self._period_s = 1 / (options.max_fps or (SOFTWARE_FPS if is_slow else DISPLAY_FPS))
            status = None if receiver is None else receiver.status
            has_pointer = window is not None
            self._panels = CallSurface(status, has_pointer=has_pointer)
            self._recorder: Recorder | None = None
            stack.callback(self._close_recording)
            if (path := options.record) is not None:
                if path.is_file():  # of a stay before
                    path = new_path(path.parent, path.stem, ".mp4")
                self._record(Recorder(path, size, self._sound.begin_track))
            self._camera: CameraOutput | None = None
            if options.camera is not None:
                self._camera = stack.enter_context(closing(CameraOutput(options.camera, size)))
            workers = num_workers(os.cpu_count())
            self._pool = stack.enter_context(DecodePool(OnnxDecoder, clock, workers=workers))
            shaders = choose_decoder(options.decode, context, self._renderer, clock)
            if shaders is not None:
                stack.enter_context(shaders)
            self._draw_clock: DrawClock[list[float]] = DrawClock(context)
            self._scheduler = Scheduler()
            self._presenter = AvatarPresenter(
                source,
                self._renderer,
                self._pool,
                self._scheduler,
                shaders=shaders,
                meter=self._meter,
                levels=self._sound.levels,
                clock=clock,
            )
            self._self_view = None
            if controls is not None:
                publisher = controls.publisher
                reflection = Reflection(publisher.avatar, publisher.track)
                publisher.watch(reflection.receive)
                self._self_view = SelfView(context, reflection, options.decode)
                stack.callback(self._self_view.close)
            self._resources = stack.pop_all()
        self._started_s = self._clock()

    def close(self) -> None:
        """Stop decoding, and finish the recordings."""
        self._resources.close()

    def run(
        self, seconds: float | None = None, should_stop: Callable[[], bool] = lambda: False
    ) -> None:
        """Draw until the time is over, `should_stop` says so, or the user closes the window."""
        period_s = self._period_s
        begin_s = next_s = self._clock()
        while not should_stop():
            now = self._clock()
            if seconds is not None and now - begin_s >= seconds:
                return
            if now < next_s:
                time.sleep(min(next_s - now, 0.05))
                continue
            # After an image that came late the next one is early, but no more than one.
            next_s = max(next_s + period_s, now - period_s)
            if not self.step(now):
                return

    def prepare(self, timeout_s: float = PREPARE_TIMEOUT_S) -> None:
        """Get everybody ready who has a face by now: decoders, shaders, first maps.

        What this costs belongs to no frame: nothing of it is shown, recorded or measured. A peer
        that is not ready in time is a placeholder until then.
        """
        deadline_s = self._clock() + timeout_s
        while (now := self._clock()) < deadline_s:
            scene, _ = self._plan(now)
            self._presenter.collect(now)
            if self._presenter.is_ready(scene):
                self._renderer.draw(scene.placements, scene.camera)
                break
            time.sleep(PREPARE_POLL_S)
        self._meter.clear()
        self._started_s = self._clock()

    def step(self, now: float) -> bool:
        """Draw one frame; return False once the user wants to leave."""
        state, panels = self.state, self._panels
        is_open = self._begin(now)
        keyboard(state)
        mouse(state, self.pick)
        tasks = settle(state)
        if state.wants_close or not is_open:
            self.surface.end()
            return False
        scene, plan = self._plan(now)
        self._scene = scene
        own, sound = self._draw_own(now), self._sound.state()
        panels.build(now, scene, self._presenter, state, own=own, sound=sound)
        self.surface.end()
        tasks += settle(state)
        self._follow_face()
        if trouble := self._sound.follow(state, panels.status.participants, now):
            panels.notice(trouble, now)
        self._pool.wait_idle(DECODE_WAIT_S)
        self._presenter.collect(now)
        self._draw(self._presenter.dressed(scene), plan, now)
        for task in tasks:
            self._carry_out(task, now)
        self._num_frames += 1
        return True

    def _begin(self, now: float) -> bool:
        """Begin a frame with what the user did; return False once they close the window."""
        state = self.state
        if self._window is None:
            self.surface.begin(now, self._renderer.size, content_scale=state.scale)
            return True
        is_open = self._window.poll()
        self._renderer.resize(self._window.size_px)
        self._window.begin(now, scale=state.scale)
        return is_open

    def _draw(self, scene: CallScene, plan: Plan, now: float) -> None:
        """Draw a frame, and show and record it."""
        begin_s = self._clock()
        # What a frame cost is known some frames later, when the GPU is done with it.
        drawn: list[float] = []
        with self._draw_clock.around(drawn):
            last = self._renderer.draw(scene.placements, scene.camera, room=scene.room)
            self.surface.paint(self._renderer.image, panels=self._window is None)
        self.last_draw = last
        drawn += [last.num_triangles, plan.shaded_px * last.drawn_share]
        for (num_triangles, shaded_px), seconds in self._draw_clock.take():
            self._scheduler.costs.observe_draw(int(num_triangles), shaded_px, seconds)
        image = None
        if self._window is None:
            image = self._renderer.read_pixels()  # waits for the GPU: the draw time is a true one
        self._meter.add("draw", self._clock() - begin_s)
        if self._recorder is not None or self._camera is not None:
            shown = self._renderer.read_pixels() if image is None else image
            try:
                if self._camera is not None:
                    self._camera.write(shown)
            except OptionError as error:
                self._camera = None
                self._fail(str(error))
                self._panels.notice(str(error), now)
            try:
                if self._recorder is not None:
                    self._recorder.write(shown, now)
            except OptionError as error:
                self._record(None)
                self._fail(str(error))
                self._panels.notice(str(error), now)
        if self._window is not None:
            self._window.show(self._show)

    def _record(self, recorder: Recorder | None) -> None:
        """Record from now on, or no more, and tell the others."""
        self._recorder, self.state.is_recording = recorder, recorder is not None
        if self._receiver is not None:
            self._receiver.say_recording(self.state.is_recording)

    def _follow_face(self) -> None:
        """Do to the user's own face what the state says."""
        state, controls = self.state, self._controls
        if controls is None or state.own_face == "none":
            return
        controls.publisher.mode = state.own_face
        if state.source and state.source != self._source:
            controls.choose(state.source)
        self._source = state.source

    def _toggle_recording(self) -> str:
        """Begin or end a recording by key; return what to tell the user."""
        if self._recorder is not None:
            return self._end_recording()
        path = new_path(FOLDERS.user_videos_path / "PiCA Telepresence", "recording", ".mp4")
        self._record(Recorder(path, self._renderer.size, self._sound.begin_track))
        return f"Recording into {path.name}"

    def _end_recording(self) -> str:
        recorder = self._recorder
        assert recorder is not None
        self._record(None)
        recorder.close()
        return f"Saved {recorder.path.name} in {recorder.path.parent}"

    def _close_recording(self) -> None:
        path = None if self._recorder is None else self._recorder.path
        if path is not None and self._attempt(self._end_recording):
            say(f"wrote {path}")

    def _attempt(self, write: Callable[[], object]) -> bool:
        """Write something; return whether that was possible."""
        try:
            write()
        except OptionError as error:
            self._fail(str(error))
            return False
        return True

    def _fail(self, failure: str) -> None:
        self.failures.append(failure)
        say(failure)

    def pick(self, x: float, y: float) -> int | None:
        """Whose head is at a point of the surface, units, y down; see `FaceState.place`."""
        if self._scene is None:
            return None
        pixels = self._pixels_a_unit
        peer = pick_head(self._scene.placements, self._scene.camera, x * pixels, y * pixels)
        return next((face.place for face in self._scene.faces if face.peer_id == peer), None)

    def wait_decoded(self, timeout_s: float) -> bool:
        """Wait until nothing is being decoded; False when the time runs out first."""
        return self._pool.wait_idle(timeout_s)

    def save_image(self, path: Path) -> bool:
        """Write the last frame as PNG; return whether that was possible."""
        return self._attempt(lambda: save_png(path, self._renderer.read_image()))

    @property
    def problems(self) -> dict[str, str]:
        """Why peers are drawn as placeholders, by peer id."""
        return self._presenter.problems

    def report(self) -> dict[str, Any]:
        """What was drawn so far; durations in milliseconds."""
        elapsed_s = self._clock() - self._started_s
        return {
            "frames_rendered": self._num_frames,
            "render_fps": round(self._num_frames / elapsed_s, 2) if elapsed_s > 0 else 0.0,
            "rendered_peers": len(self._presenter.seen),
            "decodes": self._presenter.num_decoded(),
            "decodes_replaced": self._pool.num_replaced,
            "errors": self._presenter.num_errors,
            "gl_renderer": self._renderer.gl_renderer,
            "triangles": self.last_draw.num_triangles if self.last_draw else 0,
            **self._meter.summaries(),
        }

    def _plan(self, now: float) -> tuple[CallScene, Plan]:
        scene = self._presenter.arrange(now, self._renderer.size, self.state, self._panels.free)
        self.state.orbit = scene.limits.clamped(self.state.orbit)
        return scene, self._presenter.decide(scene, (scene.camera,), BUDGET_SHARE * self._period_s)

    def _show(self, screen: moderngl.Framebuffer) -> None:
        """Put a frame on the window. What steers the call is there, not in what is kept of it."""
        self._renderer.present(screen)
        self.surface.paint(screen, signs=False)

    def _draw_own(self, now: float) -> OwnFaceView:
        """Return the own face; its picture if there is room for it."""
        if self._controls is None or self._self_view is None:
            return OwnFaceView()
        if notice := self._controls.take_notice():
            self._panels.notice(notice, now)
        height = own_face_height(self.state)
        height_px = round(height * self._pixels_a_unit)
        return self._self_view.look(now, height_px, self._controls, self.surface)

    @property
    def _pixels_a_unit(self) -> float:
        return self._renderer.size[0] / max(self.surface.io.display_size.x, 1)

    def _carry_out(self, request: Request, now: float) -> None:
        """Do once what the user asked for."""
        match request:
            case str():
                self._panels.notice(request, now)
            case Action.RECORD:
                try:
                    notice = self._toggle_recording()
                except (ClientError, ModuleNotFoundError) as error:  # a full disk ends no call
                    notice = str(error)
                self._panels.notice(notice, now)
            case Action.FULL_SCREEN if self._window is not None:
                self._window.toggle_full_screen()
            case Action.COPY_INVITATION:
                imgui.set_clipboard_text(self._panels.status.invitation)
                self._panels.notice("Invitation copied", now)
            case messages.RemovePeer() | messages.MutePeer() | messages.BarIdentity():
                if self._receiver is not None:
                    self._receiver.moderate(request)


class SelfView:
    """The user's own face as the others see it, decoded and drawn beside the call into a texture of
    its own, and what the tracker sees.

    Args:
        context: Where to draw; current on this thread.
        decode: Where it is decoded.
    """

    def __init__(
        self, context: moderngl.Context, reflection: Reflection, decode: DecodeChoice = "auto"
    ) -> None:
        self._renderer = Renderer(context, (16, 12), RENDER)
        self._pool = DecodePool(OnnxDecoder)
        self._shaders = choose_decoder(decode, context, self._renderer)
        self._presenter = AvatarPresenter(
            reflection.call, self._renderer, self._pool, Scheduler(), shaders=self._shaders
        )
        self._looked_s = -OWN_PERIOD_S
        self._shown = OwnFaceView()

    def close(self) -> None:
        """End the decoding thread, and free what decodes on the GPU."""
        self._pool.close()
        if self._shaders is not None:
            self._shaders.close()

    def draw(self, now: float, height_px: int) -> moderngl.Texture | None:
        """Draw the own face so many pixels high; None before there is one."""
        size = (round(ASPECT * height_px), height_px)
        self._renderer.resize(size)
        scene = self._presenter.arrange(now, size, ViewState(layout="line"))
        self._presenter.decide(scene, (scene.camera,), OWN_BUDGET_S)
        self._presenter.collect(now)
        scene = self._presenter.dressed(scene)
        self._renderer.draw(scene.placements, scene.camera)
        if not self._presenter.num_decoded().get(SELF_ID):
            return None
        (texture,) = self._renderer.image.color_attachments
        assert isinstance(texture, moderngl.Texture)
        return texture

    def look(
        self, now: float, height_px: int, controls: FaceControls, surface: Surface
    ) -> OwnFaceView:
        """Return what there is to see on a picture so many pixels high."""
        if height_px and now - self._looked_s >= OWN_PERIOD_S:
            self._looked_s = now
            texture, (sees, picture) = self.draw(now, height_px), controls.preview() or (None, None)
            self._shown = OwnFaceView(
                texture=None if texture is None else surface.adopt("own face", texture),
                source=controls.source,
                is_seen=sees,
                camera=None if picture is None else surface.show("camera", picture),
                aspect=1.0 if picture is None else picture.shape[1] / picture.shape[0],
            )
        return self._shown if height_px else OwnFaceView()
