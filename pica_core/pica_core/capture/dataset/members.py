"""Files within zip files, by the number of their frame; nothing is unpacked, or kept open."""

import io
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

from pica_core.errors import CaptureError

MAX_BYTES = 64_000_000


@dataclass(frozen=True, slots=True)
class Member:
    """A file within a zip file. What is kept of it is a quarter of what Python's own lists keep.

    Attributes:
        offset: Of its header; below 0: it is not there.
        size, kind: Packed size, and way of packing.
    """

    archive: Path
    frame: str
    offset: int = -1
    size: int = 0
    kind: int = 0

    def __str__(self) -> str:
        return f"{self.archive}/{self.frame}"

    def is_file(self) -> bool:
        """Whether it is there."""
        return self.offset >= 0

    def read_bytes(self) -> bytes:
        """All of it.

        Raises:
            CaptureError: It is not there, damaged, or larger than 64 MB.
        """
        try:
            with self.archive.open("rb") as file:
                file.seek(max(self.offset, 0))
                head = file.read(30)
                if self.offset < 0 or head[:4] != b"PK\3\4" or self.size > MAX_BYTES:
                    raise CaptureError(
                        f"{self}: missing, damaged or above 64 MB; download it again"
                    )
                names = int.from_bytes(head[26:28], "little") + int.from_bytes(head[28:], "little")
                file.seek(names, io.SEEK_CUR)
                data = file.read(self.size)
            if self.kind == zipfile.ZIP_DEFLATED:
                data = zlib.decompressobj(-15).decompress(data, MAX_BYTES)
        except (OSError, zlib.error) as error:
            raise CaptureError(f"{self}: cannot be read ({error}); download it again") from error
        return data


def read_members(path: Path) -> dict[str, Member]:
    """Find the members of a zip file, by their frames' numbers as six digits.

    Raises:
        CaptureError: It is missing, or not whole.
    """
    try:
        with zipfile.ZipFile(path) as opened:
            found = [(Path(each.filename).stem, each) for each in opened.infolist()]
    except FileNotFoundError:
        raise CaptureError(f"{path}: the file is missing; download it") from None
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        told = f"{path}: not a whole zip file ({error}); download it again"
        raise CaptureError(told) from error
    return {
        stem: Member(path, stem, each.header_offset, each.compress_size, each.compress_type)
        for stem, each in found
        if stem.isdecimal()
    }
