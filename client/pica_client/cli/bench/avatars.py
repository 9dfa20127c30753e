"""The avatars that a bench measures, by name."""

from __future__ import annotations

from pica_client.avatars.library import AvatarLibrary
from pica_client.local_call.local_call import choose_avatars
from pica_core.avatar.file import Avatar


def load_bench_avatar(name: str | None) -> Avatar:
    """One avatar by name or file, by default the first that ships."""
    return load_bench_avatars(name)[0]


def load_bench_avatars(names: str | None) -> list[Avatar]:
    """Avatars by names or files, separated by commas; by default all that ship."""
    library = AvatarLibrary()
    try:
        return [library.load(library.find(name)) for name in choose_avatars(names, library)]
    finally:
        library.close()
