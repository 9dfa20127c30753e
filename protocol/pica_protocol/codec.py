"""Control messages <-> bytes: the kind byte 1, then one msgpack map; and the chunks of a file.

The map's ``type`` names the message, the other keys are its fields. Reading is strict where it
protects us (sizes, types, ranges) and lax where it lets the protocol grow (unknown keys are
ignored, missing ones take their default). Sizes are bounded before msgpack sees the bytes: its
default settings turn 10 kB of hostile input into 68 MB of memory.
"""

import functools
from dataclasses import MISSING, fields
from typing import Any, Final, cast, get_args, get_origin, get_type_hints

import msgpack

from pica_protocol import limits
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.messages import MESSAGE_TYPES, Message, Metadata

CONTROL_KIND: Final = 1
"""First byte of a websocket message that carries one control message."""
CHUNK_KIND: Final = 3
"""First byte of a websocket message that carries a piece of a file."""
MAX_CHUNK_BYTES: Final = limits.MAX_CLIENT_MESSAGE_BYTES - 1
"""Bytes of file in one message."""

_PREFIX = bytes([CONTROL_KIND])
_CHUNK_PREFIX: Final = bytes([CHUNK_KIND])
_TYPE_NAMES: Final = {cls: name for name, cls in MESSAGE_TYPES.items()}


def encode_message(message: Message) -> bytes:
    """Return the websocket message that carries ``message``.

    Raises:
        ValueError: It would exceed ``MAX_CONTROL_BYTES``.
    """
    record = {"type": _TYPE_NAMES[type(message)], **cast(Any, _plain(type(message), message))}
    data = _PREFIX + cast(bytes, msgpack.packb(record))
    if len(data) > limits.MAX_CONTROL_BYTES:
        raise ValueError(
            f"{record['type']} of {len(data)} bytes, the limit is {limits.MAX_CONTROL_BYTES}"
        )
    return data


def decode_message(data: bytes, max_bytes: int = limits.MAX_CONTROL_BYTES) -> Message:
    """Return the message that ``data`` carries.

    Raises:
        RemoteProtocolError: Too long, not msgpack within the limits, of an unknown type, or with a
            field that is missing, of the wrong type or out of range; the text names it.
    """
    if len(data) > max_bytes:
        raise RemoteProtocolError(f"control message of {len(data)} bytes, the limit is {max_bytes}")
    if not data.startswith(_PREFIX):
        raise RemoteProtocolError(f"not a control message: first byte {limits.quoted(data[:1])}")
    record = _unpack(data)
    if not isinstance(record, dict):
        raise RemoteProtocolError(f"expected a map, got {type(record).__name__}")
    name = record.get("type")
    if not isinstance(name, str) or name not in MESSAGE_TYPES:
        raise RemoteProtocolError(f"unknown message type {limits.quoted(name)}")
    try:
        return cast(Message, _read(MESSAGE_TYPES[name], record, name))
    except ValueError as error:  # from the message's own check
        raise RemoteProtocolError(str(error)) from error


def encode_chunk(data: bytes | memoryview) -> bytes:
    """Return the websocket message that carries a piece of a file."""
    if not 0 < len(data) <= MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk has 1..{MAX_CHUNK_BYTES} bytes, got {len(data)}")
    return _CHUNK_PREFIX + data


def decode_chunk(message: bytes) -> memoryview:
    """Return the piece of a file in a websocket message.

    Raises:
        RemoteProtocolError: It is no chunk, empty or too long.
    """
    if not message.startswith(_CHUNK_PREFIX):
        raise RemoteProtocolError(f"not a chunk of a file: first byte {limits.quoted(message[:1])}")
    if not 1 < len(message) <= MAX_CHUNK_BYTES + 1:
        raise RemoteProtocolError(
            f"a chunk of {len(message) - 1} bytes, allowed are 1..{MAX_CHUNK_BYTES}"
        )
    return memoryview(message)[1:]


def _unpack(data: bytes) -> object:
    try:
        return msgpack.unpackb(
            memoryview(data)[1:],
            raw=False,
            strict_map_key=True,
            ext_hook=refuse_extension,
            object_pairs_hook=unique_keys,
            max_str_len=limits.MAX_PASS_BYTES,
            max_bin_len=limits.MAX_WHISPER_BYTES,
            max_array_len=limits.MAX_PEERS,
            max_map_len=limits.MAX_MAP_FIELDS,
            max_ext_len=0,
        )
    # msgpack raises ValueError and its subclasses for bad bytes; RecursionError guards its
    # fallback, OverflowError a timestamp out of range.
    except (ValueError, RecursionError, OverflowError, msgpack.UnpackException) as error:
        what = str(error) or type(error).__name__
        raise RemoteProtocolError(
            f"not msgpack within the limits: {limits.quoted(what)}"
        ) from error


def unique_keys(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Make a map of what msgpack read.

    Raises:
        ValueError: A key stands there twice: two readers might not agree on its value.
    """
    record = dict(pairs)
    if len(record) < len(pairs):
        raise ValueError("a key twice in a map")
    return record


def refuse_extension(code: int, _data: bytes) -> object:
    """Raise ValueError: msgpack's extension types have no place in our messages."""
    raise ValueError(f"extension type {code}")


_PLAIN: Final = {int: "an integer", bool: "true or false", str: "text", bytes: "bytes"}
"""The types of single values, and what errors call them."""


@functools.cache
def _fields(cls: type) -> tuple[tuple[str, Any, object], ...]:
    """Name, type and default of each field of a record."""
    hints = get_type_hints(cls)
    return tuple((each.name, hints[each.name], each.default) for each in fields(cast(Any, cls)))


def _plain(hint: Any, value: Any) -> object:
    """Return what msgpack writes for a value of a type."""
    if hint == Metadata:
        return dict(value)
    if get_origin(hint) is tuple:
        return [_plain(get_args(hint)[0], item) for item in value]
    if hint in _PLAIN:
        return value
    return {name: _plain(kind, getattr(value, name)) for name, kind, _ in _fields(hint)}


def _read(hint: Any, value: object, path: str) -> Any:
    """Return the value of a type that msgpack has read; ``path`` is what errors call it."""
    if hint in _PLAIN:
        if type(value) is not hint:  # not isinstance: True is an int to Python, not to the protocol
            raise _wrong(path, _PLAIN[hint], value)
        return value
    if get_origin(hint) is tuple and hint != Metadata:
        if not isinstance(value, list):
            raise _wrong(path, "a list", value)
        item_hint = get_args(hint)[0]
        return tuple(_read(item_hint, item, f"{path}[{i}]") for i, item in enumerate(value))
    if not isinstance(value, dict):
        raise _wrong(path, "a map", value)
    if hint == Metadata:  # msgpack lets binary keys through too
        return tuple(
            (_read(str, key, f"{path} key"), _read(str, item, f"{path}.{limits.quoted(key)}"))
            for key, item in value.items()
        )
    values = {}
    for name, kind, default in _fields(hint):
        if name in value:
            values[name] = _read(kind, value[name], f"{path}.{name}")
        elif default is MISSING:
            raise RemoteProtocolError(f"{path}.{name} is missing")
    return hint(**values)


def _wrong(path: str, wanted: str, value: object) -> RemoteProtocolError:
    return RemoteProtocolError(f"{path} must be {wanted}, got {limits.quoted(value)}")
