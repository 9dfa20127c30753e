"""One receiver from end to end: network in a thread, decoding in others, drawing in this one."""

import json
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from pica_client.avatars.fetch import AvatarFetcher
from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.decode.request import DecodeResult
from pica_client.endpoint.endpoint import LinkNews, Receiver
from pica_client.endpoint.hearing import Hearing
from pica_client.endpoint.monitor import CallMonitor
from pica_client.errors import OptionError, RelayUnreachableError
from pica_client.output import check_writable, say
from pica_client.publish.face_desk import FaceDesk
from pica_client.publish.own_face import OutgoingFace
from pica_client.transport.config import LinkConfig
from pica_client.transport.connect import trusting
from pica_client.ui.call_sound import CallSound
from pica_client.ui.captures_on_disk import new_path
from pica_client.ui.options import ViewOptions
from pica_client.ui.state import ViewState, fit_side
from pica_client.ui.viewer import Viewer
from pica_client.ui.window import Window
from pica_client.voice.opus import available
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.source import open_voice

MAX_LOGGED_DECODES = 100_000
"""Decodes kept for a latency analysis: eleven minutes of five avatars at 30 a second."""
POLL_S = 0.02
EXPECT_TIMEOUT_S = 30.0
"""Give up waiting for those who are expected after this time."""
NOTHING_SHOWN = {"frames_rendered": 0, "render_fps": 0.0}
"""What `View.run` returns when there was nothing to show."""
DRAIN_S = 0.2
"""What is decoded this soon after the picture began is not measured: decoders are being built."""


class View:
    """Runs a receiver and its viewer; `stop` may come from a signal handler.

    Attributes:
        state: What the user wants; as they left it once `run` has returned.
        was_cancelled: Whether the user did not want to wait for the room.
    """

    def __init__(
        self,
        options: ViewOptions,
        state: ViewState,
        link: LinkConfig,
        library: AvatarLibrary,
        *,
        face: OutgoingFace | None = None,
        window: Window | None = None,
        waiting: Callable[[], bool] | None = None,
        sound: SoundProcess | None = None,
    ) -> None:
        """Check what can be checked before anybody is there.

        Args:
            window: To show it in, which stays open; by default a new one.
            waiting: Called again and again until we are in the room; False gives up.
            sound: Plays and captures, and goes on afterwards; by default a new one.

        Raises:
            OptionError: A file or folder that is to be written cannot be.
        """
        check_writable(options.png, ".png")
        check_writable(options.frame_log)
        check_writable(options.viewer.record, ".mp4")
        self._options, self._link, self.state = options, link, state
        self._fetcher = self._make_fetcher(library) if options.fetch else None
        self._publisher = None if face is None else face.publisher
        state.name = link.name
        state.enter(tuple(library.names))
        self._window = window
        self._waiting = waiting
        self.was_cancelled = False
        doing = "looking into" if face is None else f"in, as {link.name},"
        self._own_sound = SoundProcess(state.sound) if sound is None else None
        sound = sound or self._own_sound
        assert sound is not None
        voice = sound if state.entered.voice == "mic" else open_voice(state.entered.voice)
        self._hearing, self._trouble = self._make_hearing(sound), ""
        self._call = Call(
            self._fetcher or library,
            ears=self._hearing,
            log_shown=options.frame_log is not None,
        )
        has_sound = self._hearing is not None or voice is sound
        self._sound = sound if has_sound else None
        is_sealed = link.secret_file is not None
        self._receiver = Receiver(
            link,
            self._call,
            voice=None if voice is None else VoicePublisher(voice, is_sealed=is_sealed),
            on_voice=None if self._hearing is None else self._hearing.receive,
            publisher=self._publisher,
            giver=None if face is None else face.giver,
            news=LinkNews(f"{doing} room {link.room} at {link.url}", say),
        )
        self._is_stopping = False
        # Drops its oldest when full.
        self._decodes: deque[tuple[str, DecodeResult]] = deque(maxlen=MAX_LOGGED_DECODES)

    def stop(self) -> None:
        """Make `run` end."""
        self._is_stopping = True

    def run(self) -> dict[str, Any]:
        """Show the call.

        Returns:
            What was drawn (`Viewer.report`) and what was received (`Receiver.stats`).

        Raises:
            RelayError: The relay is not there, or will not have us.
            GraphicsError: There is no way to draw.
        """
        options, state, film = self._options, self.state, self._options.viewer.record
        self._receiver.say_recording(film is not None)
        with ExitStack() as stack:
            if self._fetcher is not None:
                stack.callback(self._fetcher.close)
            if self._hearing is not None:
                stack.callback(self._hearing.seat, ())
            stack.enter_context(self._receiver)
            if self._own_sound is not None:
                stack.callback(self._own_sound.close)
            self._wait_for_peers()
            if self.was_cancelled:
                return dict(NOTHING_SHOWN)
            if film is not None and film.is_file():  # of the stay before this one
                film = new_path(film.parent, film.stem, ".mp4")
            desk = None
            if self._publisher is not None:
                desk = FaceDesk(self._publisher, self._link.name, state.entered.source)
                stack.callback(desk.close)
            with Viewer(
                self._call,
                replace(options.viewer, record=film),
                state=state,
                status=CallMonitor(self._receiver).status,
                on_decoded=self._note_decode if options.frame_log is not None else None,
                desk=desk,
                sound=CallSound(self._receiver.voice, self._sound),
                on_rejoin=self._rejoin,
                on_moderation=self._receiver.moderate,
                on_recording=self._receiver.say_recording,
                window=self._window,
            ) as viewer:
                # In a window a person looks on: they see who is ready, and no frozen frame.
                if self._window is None or options.frame_log is not None:
                    viewer.prepare()
                begin_s = time.monotonic()
                self._call.begin_window(begin_s)
                self._draw(viewer)
                end_s = time.monotonic()
                drawn, received = viewer.report(), self._receiver.stats(end_s)
                problems = list(viewer.problems.values())
                outputs = viewer.outputs
                png = options.png if drawn["frames_rendered"] else None
                if png is not None and viewer.save_image(png):
                    say(f"wrote {png}")
                if size := viewer.windowed_size:
                    state.window_size = fit_side(size[0]), fit_side(size[1])
                if not state.wants_rejoin:  # what was chosen for rejoining alone is forgotten
                    source = desk.source if desk is not None else state.entered.source
                    state.identity = state.entered._replace(source=source)
        for problem in problems:
            print(problem, file=sys.stderr)
        if options.frame_log is not None:
            outputs.write_text(options.frame_log, self._log(begin_s))
        return {
            **drawn,
            "ok": not outputs.failures,
            "seconds": round(end_s - begin_s, 2),
            "errors": drawn["errors"] + received["errors"],
            "problems": [*problems, *outputs.failures],
            "received": received,
            "voice": None if self._hearing is None else self._hearing.stats(self._call),
            "avatars_fetched": 0 if self._fetcher is None else self._fetcher.num_fetched,
        }

    def _make_hearing(self, sound: SoundProcess) -> Hearing | None:
        if self._options.speaker == "off":
            return None
        if (trouble := available()) is not None:
            say(f"a call without sound: {trouble}")
            return None
        return Hearing(sound)

    def _make_fetcher(self, library: AvatarLibrary) -> AvatarFetcher:
        ca_file = self._link.ca_file
        return AvatarFetcher(
            library,
            lambda: self._receiver.link.url,
            tls=None if ca_file is None else trusting(ca_file),
        )

    def _wait_for_peers(self) -> None:
        expect = self._options.expect
        deadline = time.monotonic() + EXPECT_TIMEOUT_S
        while not self._is_stopping:
            self._receiver.check()
            if self._receiver.is_connected and self._call.num_live >= expect:
                return
            if self._waiting is not None and not self._waiting():
                self.was_cancelled = True
                return
            if expect and time.monotonic() > deadline:
                raise RelayUnreachableError(
                    f"{self._call.num_live} of {expect} expected peers were seen within "
                    f"{EXPECT_TIMEOUT_S:g} s"
                )
            if self._waiting is None:
                time.sleep(POLL_S)

    def _draw(self, viewer: Viewer) -> None:
        """Draw until the time is over, the user leaves, or the network gives up."""

        def should_stop() -> bool:
            self._receiver.check()
            note = "" if self._sound is None else self._sound.state.trouble
            if note and note != self._trouble:
                say(note)
            self._trouble = note
            return self._is_stopping

        viewer.run(self._options.seconds or None, should_stop)

    def _rejoin(self) -> str:
        """Note that the user wants to rejoin; return why that cannot be."""
        self.state.name = self.state.name.strip()
        try:
            replace(self._link, name=self.state.name)
        except OptionError as error:
            return str(error)
        self.state.wants_rejoin = True
        return ""

    def _note_decode(self, result: DecodeResult) -> None:
        name = self._call.names().get(result.slot)
        if name is not None:
            self._decodes.append((name, result))

    def _log(self, begin_s: float) -> str:
        decodes = [
            (name, result.captured_us, result.submitted_s, result.finished_s)
            for name, result in self._decodes
            if result.captured_us >= (begin_s + DRAIN_S) * 1e6
        ]
        return json.dumps({"shown": self._call.take_shown(), "decodes": decodes})
