"""What the options of benches of avatars share."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from tyro.conf import OmitArgPrefixes

from pica_client.avatars.library import AvatarLibrary
from pica_client.local_call.local_call import choose_avatars
from pica_core.avatar.file import Avatar

Config = TypeVar("Config")


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarBenchOptions(Generic[Config]):
    """Options of a bench of one avatar."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    config: OmitArgPrefixes[Config]

    def load(self) -> Avatar:
        """The avatar that is measured."""
        return load_bench_avatars(self.avatar)[0]


def load_bench_avatars(names: str | None) -> list[Avatar]:
    """Avatars by names or files, separated by commas; by default all that ship."""
    library = AvatarLibrary()
    try:
        return [library.load(library.find(name)) for name in choose_avatars(names, library)]
    finally:
        library.close()
