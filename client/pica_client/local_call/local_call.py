"""A call on this machine: relay and senders as processes of their own, for demo and bench.

Capture times are subtracted from this process's clock: right on one machine, where all processes
share the monotonic clock, and on one machine only.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import OptionError
from pica_client.local_call.processes import Child, Children, end_all
from pica_client.publish import SenderConfig
from pica_client.sources import open_source, start_later
from pica_client.voice.opus import available

NAMES = (
    *("Ada", "Ben", "Cho", "Dee", "Eve", "Fay", "Gus", "Hal"),
    *("Ida", "Jon", "Kim", "Leo", "Mia", "Ned", "Oda"),
)
ROOM = "demo"
JOIN_TIMEOUT_S = 30.0
"""Longest wait until all peers are seen; five Pythons that import numpy on two busy cores take some
seconds."""
CHECK_INTERVAL_S = 0.25
"""Time between two looks at whether all processes are alive."""

DEFAULT_SOURCES = (
    "performance:talk#1",
    "performance:range_of_motion#2",
    "performance:talk#3@7",
    "performance:listen#4",
    "performance:talk#5@21",
)
"""What the peers of a demo play, in turn: three who talk, one who tries every muscle, one who
listens."""
SOURCE_STEP_S = 23.7
"""Between the starting points of peers that play the same recording (chosen: no two in phase)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LocalCallConfig:
    """The participants of the call."""

    peers: int = 5
    """Number of senders."""
    source: str | None = None
    """What all of them play, each starting elsewhere in it; by default shipped performances."""
    avatar: str | None = None
    """Names or files of avatars, separated by commas, dealt in turn; by default the shipped."""
    fps: float = 30.0
    """Frames a second of each sender."""
    is_encrypted: Annotated[bool, Parameter(name="encrypt")] = False
    """Encrypt end to end, with a secret made for this call. Needs the extra `seal`."""

    def __post_init__(self) -> None:
        if not 1 <= self.peers <= len(NAMES):
            raise OptionError(f"peers is {self.peers}; 1 to {len(NAMES)} fit the room")
        SenderConfig(fps=self.fps)  # checks it


class LocalCall:
    """The processes of a call. Start it inside a `Children` block, which ends them.

    Attributes:
        worn: Identities of the avatars that the senders wear, by name, in order.

    Raises:
        SourceError: A source that cannot be opened.
        OptionError: An avatar that is not there.
        CallProcessError: The relay did not start.
    """

    def __init__(
        self,
        config: LocalCallConfig,
        library: AvatarLibrary,
        children: Children,
        *,
        has_voices: bool = False,
    ) -> None:
        """Start; `has_voices` lets the senders speak by turns, where there is Opus."""
        sources = peer_sources(config.source, config.peers)
        for source in dict.fromkeys(sources):
            open_source(source)  # one clear error here instead of one per sender
        avatars = choose_avatars(config.avatar, library)
        names = NAMES[: config.peers]
        self.worn = {
            name: library.find(avatars[index % len(avatars)]) for index, name in enumerate(names)
        }
        secret = self.secret_file = _make_secret(children) if config.is_encrypted else None
        self.secret_arguments = [] if secret is None else ["--secret-file", str(secret)]
        self.relay, self.url = children.start_relay()
        self.senders: dict[str, Child] = {}
        has_voices &= available() is None
        for index, (name, source) in enumerate(zip(names, sources, strict=True)):
            self.senders[name] = children.start(
                f"sender {name}",
                *("send", "--url", self.url, "--room", ROOM, "--name", name),
                *("--avatar", avatars[index % len(avatars)], "--source", source),
                *("--fps", f"{config.fps:g}"),
                *("--give-avatar", "no"),  # the viewer has the same files
                *(["--voice", f"speech#{index + 1}/{config.peers}"] if has_voices else []),
                *self.secret_arguments,
            )

    def check(self) -> None:
        """Look after the processes.

        Raises:
            CallProcessError: One of them has ended: names it, and quotes its last words.
        """
        for child in (self.relay, *self.senders.values()):
            child.check()

    def finish(self) -> dict[str, dict[str, Any]]:
        """End the senders and collect what they say, by name."""
        self.check()
        end_all(self.senders.values(), 5.0)
        return {name: child.result() for name, child in self.senders.items()}


def _make_secret(children: Children) -> Path:
    """Make the secret of one call, and check that it can be used here."""
    from pica_client.e2ee.guard import Guard
    from pica_client.e2ee.secret import RoomSecret, save_secret

    file, secret = children.folder / "room.secret", RoomSecret.new()
    save_secret(file, secret)
    Guard(secret)
    return file


def peer_sources(source: str | None, num_peers: int) -> list[str]:
    """What each of some peers plays: one source, each starting elsewhere in it, or those of
    `DEFAULT_SOURCES` in turn."""
    if source is None:
        return [DEFAULT_SOURCES[index % len(DEFAULT_SOURCES)] for index in range(num_peers)]
    return [start_later(source, index * SOURCE_STEP_S) for index in range(num_peers)]


def choose_avatars(names: str | None, library: AvatarLibrary) -> list[str]:
    """Names or files of the avatars to deal, each known to the library afterwards.

    Raises:
        OptionError: None shipped and none given, or one that is not there.
    """
    chosen = library.names if names is None else [name for name in names.split(",") if name]
    if not chosen:
        raise OptionError("no avatar ships with this package; name one with --avatar FILE")
    for name in chosen:
        library.load(library.find(name))
    return chosen


def bitrates(sent: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Each peer's uplink in bits per second: payload, and on the wire (see `stats.wire_bytes`)."""
    return {
        name: {"payload": result["payload_bps"], "wire": result["wire_bps"]}
        for name, result in sent.items()
    }
