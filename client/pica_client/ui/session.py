"""`pica view` from the command line to its report: preferences, the form, and stays in rooms.

A stay is one receiver from end to end: network in a thread, decoding in others, drawing in this
one. Where a form asks, it comes again with the reason when the relay refuses.
"""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pica_client.avatars.fetch import AvatarFetcher
from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.endpoint import Receiver
from pica_client.errors import ClientError, OptionError, RelayUnreachableError
from pica_client.publish import DEFAULT_SOURCE, FaceControls, Outgoing, open_face
from pica_client.system import check_writable, on_stop_signal, say
from pica_client.transport.connect import DEFAULT_URL, LinkConfig
from pica_client.ui.call_sound import CallSound
from pica_client.ui.lobby import JoinForm, Lobby, follow_invite
from pica_client.ui.options import ViewOptions, check_voice, parse_size
from pica_client.ui.state import PreferencesFile, ViewState
from pica_client.ui.viewer import Viewer
from pica_client.ui.window import Window
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.source import VoicePublisher, open_voice
from pica_core.errors import AvatarFileError

DEFAULT_NAME = "viewer"
WATCH = "none"
"""What ``--send`` is given by a user who only watches."""
POLL_S = 0.02
EXPECT_TIMEOUT_S = 30.0
"""How long the peers of ``--expect`` are waited for."""
NOTHING_SHOWN = {"frames_rendered": 0, "render_fps": 0.0}
"""The result when there was nothing to show."""


def first_state(options: ViewOptions, kept: PreferencesFile | None) -> ViewState:
    """Return what the command line gives, else what was kept, else defaults.

    Args:
        kept: What a form that asks remembers; None: no form asks.

    Raises:
        OptionError: An option cannot be right.
    """
    state = ViewState(name=DEFAULT_NAME, source="", voice="none") if kept is None else kept.load()
    kinds = ("url", "room", "name", "secret_file")
    given: dict[str, str | None] = {k: str(getattr(options.join, k) or "") for k in kinds}
    given |= {"avatar": options.own_avatar, "layout": options.layout, "voice": options.voice}
    for name, value in given.items():
        if value:
            setattr(state, name, value)
    if options.link:
        try:
            follow_invite(state, options.link)
        except ValueError as error:
            raise OptionError(f"link: {error}") from error
    if options.send is not None:
        state.source = "" if options.send == WATCH else options.send
    if options.own_avatar is not None and not state.source:
        raise OptionError(
            f"own-avatar is the look of your own face; to send one, add --send {DEFAULT_SOURCE}"
        )
    if state.voice.startswith("mic:"):
        state.sound = replace(state.sound, microphone=state.voice.removeprefix("mic:"))
        state.voice = "mic"
    elif options.voice is None and (available() is not None or not find_spec("soundcard")):
        state.voice = "none"
    if options.speaker:
        state.sound = replace(state.sound, speaker=options.speaker)
    if options.clean is not None:
        state.sound = replace(state.sound, cleans=options.clean)
    if kept is None:  # at the form a voice can be chosen
        check_voice(state.source, state.voice)
    if options.size is not None:
        state.window_size = parse_size(options.size)
    return state


def link_of(options: ViewOptions, state: ViewState) -> LinkConfig:
    """Return the connection that is asked for.

    A token file is for the relay of ``--url`` alone: an invite link must not take it to another.

    Raises:
        OptionError: A part of it cannot be right; names it.
    """
    url, token = state.url.strip(), state.token.strip()
    takes_file = not token and url == (options.join.url or DEFAULT_URL)
    secret_file = state.secret_file.strip()
    return options.join.link(
        seconds=options.seconds,
        url=url,
        room=state.room.strip(),
        name=state.name.strip(),
        secret_file=Path(secret_file).expanduser() if secret_file else None,
        token=token,
        token_file=options.join.token_file if takes_file else None,
    )


def view_calls(
    options: ViewOptions,
    state: ViewState,
    library: AvatarLibrary,
    kept: PreferencesFile | None = None,
) -> dict[str, Any]:
    """Stay in the room that the state names, or that a form asks for, until the user leaves.

    Args:
        kept: Where preferences go afterwards, when a form asks where to go; None: no form asks.

    Returns:
        What was drawn (`Viewer.report`) and what was received (`Receiver.stats`); `NOTHING_SHOWN`
        when the user left before.

    Raises:
        OptionError: A file that is to be written cannot be.
        GraphicsError: There is no way to draw.
        ClientError: Without a form, what else `stay` or `open_face` raises.
    """
    check_writable(options.png)
    check_writable(options.record)
    form = JoinForm(state=state, link_of=partial(link_of, options))
    with closing(SoundProcess(state.sound)) as sound, ExitStack() as stack:
        lobby = None
        if not options.headless:
            lobby = stack.enter_context(Lobby(state.window_size, library, sound))
        while lobby is None or kept is None or lobby.ask(form):
            try:
                result = stay(options, state, library, sound, lobby)
            except (ClientError, AvatarFileError) as error:
                if kept is None:
                    raise
                form.refuse(error)
                continue
            if result is not None and kept is not None:
                kept.save(state)
            if result is not None or kept is None:
                return result or dict(NOTHING_SHOWN)
    return dict(NOTHING_SHOWN)


def stay(
    options: ViewOptions,
    state: ViewState,
    library: AvatarLibrary,
    sound: SoundProcess,
    lobby: Lobby | None,
) -> dict[str, Any] | None:
    """Stay in one room, until the user leaves or a signal ends it.

    Args:
        state: What the user wants; as they left it afterwards.
        sound: Plays and captures, and goes on afterwards.
        lobby: Has the window and says there what is being waited for; None draws off the screen.

    Returns:
        As `view_calls`; None when the user did not want to wait.

    Raises:
        RelayError: The relay is not there, or will not have us.
        GraphicsError: There is no way to draw.
    """
    link = link_of(options, state)
    if options.join.token_file is not None and not link.token and link.token_file is None:
        say(f"token-file is not sent to {link.url}; --url {link.url} would send it")
    state.name = link.name
    state.enter()
    is_stopping = threading.Event()
    with on_stop_signal(is_stopping.set), ExitStack() as stack:
        own = Outgoing()
        if state.source:
            own = open_face(
                state.source,
                link,
                library,
                say,
                avatar=state.avatar.strip() or None,
                give=options.join.give_avatar,
            )
            stack.callback(own.close)
        fetcher = AvatarFetcher(library, lambda: receiver.link.url)
        stack.callback(fetcher.close)
        voice = sound if state.voice == "mic" else open_voice(state.voice)
        own_voice = None
        if voice is not None:
            own_voice = VoicePublisher(voice, is_sealed=link.secret_file is not None)
        if lacking := available():
            say(f"a call without sound: {lacking}")
        else:
            stack.callback(sound.seat, ())
        call = Call(fetcher, ears=None if lacking else sound)
        receiver = Receiver(link, call, replace(own, voice=own_voice), say=say)
        receiver.say_recording(options.record is not None)
        stack.enter_context(receiver)

        def is_stopped() -> bool:
            receiver.check()
            return is_stopping.is_set()

        def is_ready() -> bool:
            if options.expect and time.monotonic() > deadline_s:
                raise RelayUnreachableError(
                    f"{call.num_live} of {options.expect} expected peers were seen within "
                    f"{EXPECT_TIMEOUT_S:g} s"
                )
            is_here = receiver.link.is_joined and call.num_live >= options.expect
            return is_stopped() or is_here

        deadline_s = time.monotonic() + EXPECT_TIMEOUT_S
        if lobby is None:
            while not is_ready():
                time.sleep(POLL_S)
        elif not lobby.wait(is_ready):
            return None
        plays = CallSound(own_voice, None if lacking and voice is not sound else sound)
        window = None if lobby is None else lobby.window
        result = _show(options, state, receiver, plays, window, is_stopped)
        return {**result, "voice": plays.report(call), "avatars_fetched": fetcher.num_fetched}


def _show(
    options: ViewOptions,
    state: ViewState,
    receiver: Receiver,
    sound: CallSound,
    window: Window | None,
    is_stopped: Callable[[], bool],
) -> dict[str, Any]:
    """Draw a call until the user leaves; return what was drawn and received."""
    call, face = receiver.call, receiver.own.face
    with ExitStack() as stack:
        controls = None
        if face is not None:
            controls = FaceControls(face, receiver.link.config.name, state.source)
            stack.callback(controls.close)
        viewer = Viewer(
            call,
            options,
            state=state,
            receiver=receiver,
            controls=controls,
            sound=sound,
            window=window,
        )
        with viewer:
            # In a window a person looks on: they see who is ready, at once.
            if window is None or options.expect:
                viewer.prepare()
            begin_s = time.monotonic()
            call.begin_window(begin_s)
            viewer.run(options.seconds or None, is_stopped)
            end_s = time.monotonic()
            drawn, received = viewer.report(), receiver.stats(end_s)
            problems, failures = list(viewer.problems.values()), viewer.failures
            png = options.png if drawn["frames_rendered"] else None
            if png is not None and viewer.save_image(png):
                say(f"wrote {png}")
            if window is not None and (size := window.windowed_size):
                state.window_size = size
            if controls is not None:
                state.source = controls.source
    for problem in problems:
        say(problem)
    return {
        **drawn,
        "ok": not failures,
        "seconds": round(end_s - begin_s, 2),
        "errors": drawn["errors"] + received["errors"],
        "problems": [*problems, *failures],
        "received": received,
    }
