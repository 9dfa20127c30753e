"""`pica view` from the command line to its report: preferences, the form, and stays in rooms.

A stay is one receiver from end to end: network in a thread, decoding in others, drawing in this
one. Where a form asks, it comes again with the reason when the relay refuses.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pica_client.avatars.fetch import AvatarFetcher
from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.endpoint.endpoint import LinkNews, Receiver
from pica_client.endpoint.hearing import Hearing
from pica_client.errors import ClientError, OptionError, RelayUnreachableError
from pica_client.output import check_writable, say
from pica_client.publish.face_controls import FaceControls
from pica_client.publish.publisher import DEFAULT_SOURCE, Outgoing, open_face
from pica_client.transport.config import LinkConfig
from pica_client.transport.connect import trusting
from pica_client.ui.call_sound import CallSound
from pica_client.ui.join_form import JoinForm, follow_invite
from pica_client.ui.lobby import Lobby
from pica_client.ui.options import ViewOptions, check_voice, connect_timeout_s, parse_size
from pica_client.ui.state import PreferencesFile, ViewState, fit_side
from pica_client.ui.viewer import Viewer
from pica_client.ui.window import Window
from pica_client.voice.opus import available
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.source import open_voice
from pica_core.errors import AvatarFileError

DEFAULT_URL = "ws://127.0.0.1:8765"
DEFAULT_ROOM = "lobby"
DEFAULT_NAME = "viewer"
WATCH = "none"
"""What ``--send`` is given by a user who only watches."""
POLL_S = 0.02
EXPECT_TIMEOUT_S = 30.0
"""How long the peers of ``--expect`` are waited for."""
NOTHING_SHOWN = {"frames_rendered": 0, "render_fps": 0.0}
"""The result when there was nothing to show."""

Stopping = Callable[[Callable[[], None]], AbstractContextManager[None]]
"""Makes a signal call what it is given, for the length of a block."""


def first_state(options: ViewOptions, kept: PreferencesFile | None) -> ViewState:
    """Return what the command line gives, else what was kept, else defaults.

    Args:
        kept: What a form that asks remembers; None: no form asks.

    Raises:
        OptionError: An option cannot be right.
    """
    asks = kept is not None
    state = ViewState() if kept is None else kept.load()
    given = {"url": options.url, "room": options.room, "name": options.name}
    given |= {"avatar": options.own_avatar, "layout": options.layout}
    given |= {name: str(getattr(options, name) or "") for name in ("ca_file", "secret_file")}
    for name, value in given.items():
        if value:
            setattr(state, name, value)
    if options.link:
        try:
            follow_invite(state, options.link)
        except ValueError as error:
            raise OptionError(f"link: {error}") from error
    state.url, state.room = state.url or DEFAULT_URL, state.room or DEFAULT_ROOM
    state.name = state.name or ("" if asks else DEFAULT_NAME)
    if options.send is not None:
        state.source = "" if options.send == WATCH else options.send
    elif state.source is None:
        state.source = DEFAULT_SOURCE if asks else ""
    if options.own_avatar is not None and not state.source:
        raise OptionError(
            f"own-avatar is the look of your own face; to send one, add --send {DEFAULT_SOURCE}"
        )
    _choose_sound(options, state, asks=asks)
    if options.viewer.size is not None:
        state.window_size = parse_size(options.viewer.size)
    return state


def _choose_sound(options: ViewOptions, state: ViewState, *, asks: bool) -> None:
    voice, sound = options.voice, state.sound
    if options.speaker:
        sound = replace(sound, speaker=options.speaker)
    if voice is not None and voice.startswith("mic:"):
        voice, sound = "mic", replace(sound, microphone=voice.removeprefix("mic:"))
    if options.clean is not None:
        sound = replace(sound, cleans=options.clean)
    state.sound = sound
    if voice is None and asks and available() is None:
        voice = state.voice or ("mic" if find_spec("soundcard") else None)
    state.voice = voice or "none"
    if not asks:  # at the form a voice can be chosen
        check_voice(state.source or "", state.voice)


def link_of(options: ViewOptions, state: ViewState) -> LinkConfig:
    """Return the connection that is asked for.

    A token file is for the relay of ``--url`` alone: an invite link must not take it to another.

    Raises:
        OptionError: A part of it cannot be right; names it.
    """
    url, token = state.url.strip(), state.token.strip()
    takes_file = not token and url == (options.url or DEFAULT_URL)
    needs_ca = options.ca_file is not None or "wss://" in url
    return LinkConfig(
        url=url,
        room=state.room.strip(),
        name=state.name.strip(),
        connect_timeout_s=connect_timeout_s(wait=options.wait, seconds=options.seconds),
        secret_file=_path(state.secret_file),
        token=token,
        token_file=options.token_file if takes_file else None,
        ca_file=_path(state.ca_file) if needs_ca else None,
        redirect_hosts=options.redirect_hosts,
    )


def open_own(
    options: ViewOptions, state: ViewState, link: LinkConfig, library: AvatarLibrary
) -> Outgoing:
    """Make the face ready that is asked for; raises as `open_face` does."""
    if not state.source:
        return Outgoing()
    avatar = state.avatar.strip() or None
    return open_face(state.source, link, library, say, avatar=avatar, give=options.give_avatar)


def view_calls(
    options: ViewOptions,
    state: ViewState,
    library: AvatarLibrary,
    stopping: Stopping,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Stay in the room that the state names, or that a form asks for, until the user leaves.

    Args:
        stopping: How signals end it.
        kept: Where preferences go afterwards, when a form in a window asks where to go; None: no
            form asks.

    Returns:
        As `Stay.run`; `NOTHING_SHOWN` when the user left at the form.

    Raises:
        GraphicsError: There is no way to draw.
        ClientError: Without a form, what else `Stay` or `open_own` raises.
    """
    form = JoinForm(state, partial(link_of, options))
    state.can_rejoin = kept is not None
    with ExitStack() as stack:
        window = lobby = None
        sound = stack.enter_context(closing(SoundProcess(state.sound)))
        if kept is not None:
            window = stack.enter_context(Window(state.window_size))
            lobby = stack.enter_context(Lobby(window, library, None if available() else sound))
        pool = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="own-face"))

        def stay_once() -> dict[str, Any] | None:
            """Stay in one room; None when the user did not want to wait for it."""
            link = link_of(options, state)
            if options.token_file is not None and not link.token and link.token_file is None:
                say(f"token-file is not sent to {link.url}; --url {link.url} would send it")
            opening = pool.submit(open_own, options, state, link, library)
            try:
                if lobby is not None and not lobby.wait("Getting your avatar …", opening.done):
                    return None
                waiting = None if lobby is None else partial(lobby.show_waiting, "Connecting …")
                stay = Stay(options, state, link, library, opening.result(), window, sound, waiting)
                with stopping(stay.stop):
                    return stay.run()
            finally:
                opening.add_done_callback(_let_go)

        while lobby is None or lobby.ask(form):
            try:
                result = stay_once()
            except (ClientError, AvatarFileError) as error:
                if lobby is None:
                    raise
                form.refuse(error)
                continue
            if result is not None:
                if kept is not None:
                    kept.save(state)
                if not state.wants_rejoin:
                    return result
            form.ask_again()
    return dict(NOTHING_SHOWN)


class Stay:
    """One stay in one room; `stop` may come from a signal handler.

    Args:
        state: What the user wants; as they left it once `run` has returned.
        own: What the user sends.
        window: To show it in, which stays open; None opens a new one.
        sound: Plays and captures, and goes on afterwards.
        waiting: Called again and again until we are in the room; False gives up.

    Raises:
        OptionError: A file or folder that is to be written cannot be.
    """

    def __init__(
        self,
        options: ViewOptions,
        state: ViewState,
        link: LinkConfig,
        library: AvatarLibrary,
        own: Outgoing,
        window: Window | None,
        sound: SoundProcess,
        waiting: Callable[[], bool] | None,
    ) -> None:
        check_writable(options.png, ".png")
        check_writable(options.viewer.record, ".mp4")
        self._options, self._link, self._state = options, link, state
        self._window, self._waiting = window, waiting
        state.name = link.name
        state.enter()
        state.side = "statistics" if options.statistics else "none"
        tls = None if link.ca_file is None else trusting(link.ca_file)
        self._fetcher = AvatarFetcher(library, lambda: self._receiver.link.url, tls=tls)
        voice = sound if state.voice == "mic" else open_voice(state.voice or "none")
        self._hearing = None
        if (lacking := available()) is None:
            self._hearing = Hearing(sound)
        else:
            say(f"a call without sound: {lacking}")
        self._sound = sound if self._hearing is not None or voice is sound else None
        self._call = Call(self._fetcher, ears=self._hearing)
        doing = "looking into" if own.face is None else f"in, as {link.name},"
        is_sealed = link.secret_file is not None
        self._publisher = own.face
        self._receiver = Receiver(
            link,
            self._call,
            replace(
                own,
                voice=None if voice is None else VoicePublisher(voice, is_sealed=is_sealed),
            ),
            on_voice=None if self._hearing is None else self._hearing.receive,
            news=LinkNews(f"{doing} room {link.room} at {link.url}", say),
        )
        self._is_stopping = False

    def stop(self) -> None:
        """Make `run` end."""
        self._is_stopping = True

    def run(self) -> dict[str, Any] | None:
        """Show the call.

        Returns:
            What was drawn (`Viewer.report`) and what was received (`Receiver.stats`); None when
            `waiting` gave up.

        Raises:
            RelayError: The relay is not there, or will not have us.
            GraphicsError: There is no way to draw.
        """
        options, state = self._options, self._state
        self._receiver.say_recording(options.viewer.record is not None)
        with ExitStack() as stack:
            stack.callback(self._fetcher.close)
            if self._hearing is not None:
                stack.callback(self._hearing.seat, ())
            stack.enter_context(self._receiver)
            if not self._wait_for_peers():
                return None
            controls = None
            if self._publisher is not None:
                controls = FaceControls(self._publisher, self._link.name, state.source or "")
                stack.callback(controls.close)
            with Viewer(
                self._call,
                options.viewer,
                state=state,
                receiver=self._receiver,
                controls=controls,
                sound=CallSound(self._receiver.own.voice, self._sound),
                window=self._window,
            ) as viewer:
                # In a window a person looks on: they see who is ready, at once.
                if self._window is None:
                    viewer.prepare()
                begin_s = time.monotonic()
                self._call.begin_window(begin_s)
                viewer.run(options.seconds or None, self._should_stop)
                end_s = time.monotonic()
                drawn, received = viewer.report(), self._receiver.stats(end_s)
                problems, outputs = list(viewer.problems.values()), viewer.outputs
                png = options.png if drawn["frames_rendered"] else None
                if png is not None and viewer.save_image(png):
                    say(f"wrote {png}")
                if size := viewer.windowed_size:
                    state.window_size = fit_side(size[0]), fit_side(size[1])
                if controls is not None:
                    state.source = controls.source
        for problem in problems:
            say(problem)
        return {
            **drawn,
            "ok": not outputs.failures,
            "seconds": round(end_s - begin_s, 2),
            "errors": drawn["errors"] + received["errors"],
            "problems": [*problems, *outputs.failures],
            "received": received,
            "voice": None if self._hearing is None else self._hearing.stats(self._call),
            "avatars_fetched": self._fetcher.num_fetched,
        }

    def _wait_for_peers(self) -> bool:
        """Wait until we are in the room with those expected; False when `waiting` gave up."""
        expect = self._options.expect
        deadline = time.monotonic() + EXPECT_TIMEOUT_S
        while not self._is_stopping:
            self._receiver.check()
            if self._receiver.is_connected and self._call.num_live >= expect:
                return True
            if self._waiting is None:
                time.sleep(POLL_S)
            elif not self._waiting():
                return False
            if expect and time.monotonic() > deadline:
                raise RelayUnreachableError(
                    f"{self._call.num_live} of {expect} expected peers were seen within "
                    f"{EXPECT_TIMEOUT_S:g} s"
                )
        return True

    def _should_stop(self) -> bool:
        """Return True once the stay is to end; raise what ended the network."""
        self._receiver.check()
        return self._is_stopping


def _let_go(opening: Future[Outgoing]) -> None:
    """Free a tracker's port once its stay is over."""
    if opening.exception() is None and (face := opening.result().face) is not None:
        face.close()


def _path(text: str) -> Path | None:
    return Path(text.strip()).expanduser() if text.strip() else None
