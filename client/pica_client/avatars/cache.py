"""Avatars of others on this machine's disk, so that each is fetched once.

Files are named by their hash; when they have too many bytes, the one used longest ago goes first.
"""

import os
import secrets
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from pica_client.user_folders import cache_folder, make_private
from pica_core.avatar.file import avatar_id
from pica_core.errors import AvatarFileError

MAX_BYTES = 2**30
"""Bytes that all files together may take (chosen: four hundred avatars of the size that ships)."""
SUFFIX = ".pica"
UNFINISHED = ".part"
ABANDONED_AFTER_S = 86_400.0


class AvatarCache:
    """A bounded folder of avatar files by hash. One thread uses it; processes may share it."""

    def __init__(self, folder: Path | None = None, max_bytes: int = MAX_BYTES) -> None:
        """Prepare the folder, by default `cache_folder`; one that cannot be written is replaced by
        a temporary one. The newest file is kept whatever its size.
        """
        self._max_bytes = max_bytes
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.folder = cache_folder() if folder is None else folder
        try:
            if folder is None:
                make_private(self.folder)
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            trial = self.unfinished("trial")
            trial.touch()
            trial.unlink()
            for path in self.folder.glob(f"*{UNFINISHED}"):
                with suppress(OSError):
                    if time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                        path.unlink()
        except OSError:
            self._temporary = tempfile.TemporaryDirectory(prefix="pica-cache-")
            self.folder = Path(self._temporary.name)

    def find(self, identity: str) -> Path | None:
        """The file of an avatar, if it is there and still has its hash."""
        path = self._path(identity)
        try:
            if avatar_id(path) == identity:
                os.utime(path)
                return path
        except (AvatarFileError, OSError):
            pass
        with suppress(OSError):
            path.unlink(missing_ok=True)
        return None

    def unfinished(self, identity: str) -> Path:
        """A new path for a file that is on its way."""
        return self.folder / f"{identity[:16]}-{secrets.token_hex(8)}{UNFINISHED}"

    def keep(self, unfinished: Path, identity: str) -> Path:
        """Take a file that has come whole, and make room for it; OSError if it cannot be moved."""
        path = self._path(identity)
        os.replace(unfinished, path)
        self._trim(path)
        return path

    def close(self) -> None:
        """Delete what was only temporary."""
        if self._temporary is not None:
            self._temporary.cleanup()

    def _path(self, identity: str) -> Path:
        return self.folder / f"{identity}{SUFFIX}"

    def _trim(self, newest: Path) -> None:
        files = []
        for path in self.folder.glob(f"*{SUFFIX}"):
            with suppress(OSError):  # another process trims, too
                found = path.stat()
                files.append((path == newest, found.st_mtime, found.st_size, path))
        num_too_many = sum(size for _, _, size, _ in files) - self._max_bytes
        for is_newest, _, size, path in sorted(files):
            if num_too_many <= 0 or is_newest:
                return
            with suppress(OSError):
                path.unlink()
            num_too_many -= size
