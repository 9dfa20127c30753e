"""Is this laid out like an avatar file? A look at a safetensors header without numpy. Pure.

This is the check that every upload passes while it comes in, so that a file that cannot be one is
refused after its first kilobytes. It says nothing about the numbers inside: receivers check those,
before they draw anything.

The layout: eight bytes length, little-endian, of the JSON header; the header, tensor name to type,
shape and place; then the tensors, one after the other to the end of the file.
"""

import json
from math import prod
from typing import Any, Final, TypeGuard

from pica_protocol.codec import unique_keys
from pica_protocol.limits import quoted
from pica_server.errors import UnfitFileError

MAX_HEADER_BYTES: Final = 256 * 2**10
"""Bytes of a header that receivers allow, too."""
MAX_TENSORS: Final = 1024
MAX_DIMENSIONS: Final = 8
METADATA_KEY: Final = "pica"
"""Where an avatar file keeps its manifest."""
BYTES_OF_TYPE: Final = {"F32": 4, "F16": 2, "I32": 4, "I16": 2, "U16": 2, "U8": 1}
"""The types of numbers that receivers take."""

_LENGTH_BYTES: Final = 8


class StructureCheck:
    """Reads the beginning of a file of known size, piece by piece."""

    def __init__(self, size: int) -> None:
        """Begin a file of so many bytes in all."""
        self._size = size
        self._head = bytearray()  # bounded by MAX_HEADER_BYTES and one piece
        self.is_done = False

    def receive(self, data: bytes | memoryview) -> None:
        """Take the next bytes.

        Raises:
            UnfitFileError: This will be no avatar file, whatever follows.
        """
        if self.is_done:
            return
        self._head += data
        if len(self._head) < _LENGTH_BYTES:
            return
        length = int.from_bytes(self._head[:_LENGTH_BYTES], "little")
        if not 2 <= length <= min(MAX_HEADER_BYTES, self._size - _LENGTH_BYTES):
            raise UnfitFileError(f"its header would have {length} bytes: no avatar file")
        end = _LENGTH_BYTES + length
        if len(self._head) >= end:
            check_header(bytes(self._head[_LENGTH_BYTES:end]), self._size - end)
            self.is_done = True
            self._head.clear()

    def finish(self) -> None:
        """Take note that the file has ended; raise `UnfitFileError` if it did before its header."""
        if not self.is_done:
            raise UnfitFileError("it ends within its header")


def check_header(text: bytes, num_data_bytes: int) -> None:
    """Check the JSON header of a safetensors file against the bytes that follow it.

    Raises:
        UnfitFileError: It is no JSON, no avatar's, or its tensors do not fit it and each other.
    """
    try:
        header = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=unique_keys)
    except (ValueError, RecursionError) as error:
        raise UnfitFileError("its header is not valid JSON") from error
    if not isinstance(header, dict):
        raise UnfitFileError("its header is no JSON object")
    metadata = header.pop("__metadata__", None)
    if not isinstance(metadata, dict) or not isinstance(metadata.get(METADATA_KEY), str):
        raise UnfitFileError("it has no manifest: no avatar file")
    if not 0 < len(header) <= MAX_TENSORS:
        raise UnfitFileError(f"{len(header)} tensors, allowed are 1..{MAX_TENSORS}")
    end = 0
    for begin, stop in sorted(_place(name, entry) for name, entry in header.items()):
        if begin != end:
            raise UnfitFileError("its tensors overlap, or leave a hole")
        end = stop
    if end != num_data_bytes:
        raise UnfitFileError(f"its tensors take {end} bytes, {num_data_bytes} are there")


def _place(name: str, entry: Any) -> tuple[int, int]:
    """Return where a tensor begins and ends, checked against its own type and shape."""
    if not isinstance(entry, dict):
        raise UnfitFileError(f"tensor {quoted(name)} is no JSON object")
    kind, shape, place = (entry.get(key) for key in ("dtype", "shape", "data_offsets"))
    if not isinstance(kind, str) or kind not in BYTES_OF_TYPE:
        raise UnfitFileError(f"tensor {quoted(name)} is of type {quoted(kind)}")
    if not _are_sizes(shape) or len(shape) > MAX_DIMENSIONS:
        raise UnfitFileError(f"tensor {quoted(name)} has no proper shape")
    if not _are_sizes(place) or len(place) != 2:
        raise UnfitFileError(f"tensor {quoted(name)} has no proper place")
    begin, end = place
    if end - begin != prod(shape) * BYTES_OF_TYPE[kind]:
        raise UnfitFileError(f"tensor {quoted(name)} does not have the size of its shape")
    return begin, end


def _are_sizes(values: Any) -> TypeGuard[list[int]]:
    return isinstance(values, list) and all(
        type(value) is int and 0 <= value < 2**40 for value in values
    )


def _refuse_constant(constant: str) -> None:
    raise ValueError(f"the constant {constant} is not allowed")
