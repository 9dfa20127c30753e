"""Control messages <-> bytes: the kind byte 1, then one msgpack map.

The map's ``type`` names the message, the other keys are its fields. Reading is strict where it
protects us (sizes, types, ranges) and lax where it lets the protocol grow (unknown keys are
ignored, missing ones take their default). Sizes are bounded before msgpack sees the bytes: its
default settings turn 10 kB of hostile input into 68 MB of memory.
"""

import functools
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Final, NamedTuple, Union, cast, get_args, get_origin, get_type_hints

import msgpack

from pica_protocol import limits
from pica_protocol.errors import LocalProtocolError, RemoteProtocolError
from pica_protocol.messages import MESSAGE_TYPES, Message, Metadata
from pica_protocol.store import STORE_MESSAGE_TYPES, StoreMessage

CONTROL_KIND: Final = 1
"""First byte of a websocket message that carries one control message."""

_PREFIX = bytes([CONTROL_KIND])
_TYPE_NAMES: Final = {
    cls: name
    for table in (MESSAGE_TYPES, STORE_MESSAGE_TYPES)
    for name, cls in cast(Mapping[str, type], table).items()
}

_Reader = Callable[[object, str], Any]


def encode_message(message: Message | StoreMessage) -> bytes:
    """Return the websocket message that carries ``message``.

    Raises:
        LocalProtocolError: It would exceed ``MAX_CONTROL_BYTES``.
    """
    record = {"type": _TYPE_NAMES[type(message)], **_plain_record(message)}
    data = _PREFIX + cast(bytes, msgpack.packb(record))
    if len(data) > limits.MAX_CONTROL_BYTES:
        raise LocalProtocolError(
            f"{record['type']} of {len(data)} bytes, the limit is {limits.MAX_CONTROL_BYTES}"
        )
    return data


def decode_message(data: bytes, max_bytes: int = limits.MAX_CONTROL_BYTES) -> Message:
    """Return the message that ``data`` carries.

    Raises:
        RemoteProtocolError: Too long, not msgpack within the limits, of an unknown type, or with a
            field that is missing, of the wrong type or out of range; the text names it.
    """
    return cast(Message, _decode(data, max_bytes, MESSAGE_TYPES))


def decode_store_message(data: bytes, max_bytes: int = limits.MAX_CONTROL_BYTES) -> StoreMessage:
    """Return the one of ``pica.store.1`` that ``data`` carries; raises as ``decode_message``."""
    return cast(StoreMessage, _decode(data, max_bytes, STORE_MESSAGE_TYPES))


def _decode(data: bytes, max_bytes: int, message_types: Mapping[str, type]) -> object:
    if len(data) > max_bytes:
        raise RemoteProtocolError(f"control message of {len(data)} bytes, the limit is {max_bytes}")
    if not data.startswith(_PREFIX):
        raise RemoteProtocolError(f"not a control message: first byte {limits.quoted(data[:1])}")
    record = _unpack(data)
    if not isinstance(record, dict):
        raise RemoteProtocolError(f"expected a map, got {type(record).__name__}")
    name = record.get("type")
    if not isinstance(name, str) or name not in message_types:
        raise RemoteProtocolError(f"unknown message type {limits.quoted(name)}")
    try:
        return _read_record(message_types[name], record, name)
    except ValueError as error:  # from the message's own check
        raise RemoteProtocolError(str(error)) from error


def _unpack(data: bytes) -> object:
    try:
        return msgpack.unpackb(
            memoryview(data)[1:],
            raw=False,
            strict_map_key=True,
            ext_hook=refuse_extension,
            object_pairs_hook=unique_keys,
            max_str_len=max(limits.MAX_TEXT_BYTES, limits.MAX_PASS_BYTES),
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


class _Field(NamedTuple):
    name: str
    read: _Reader
    default: object
    is_map: bool = False


def _plain_record(record: Any) -> dict[str, object]:
    values = ((field, getattr(record, field.name)) for field in _SCHEMAS[type(record)])
    return {field.name: dict(value) if field.is_map else _plain(value) for field, value in values}


def _plain(value: Any) -> object:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return _plain_record(value) if type(value) in _SCHEMAS else value


def _read_record(cls: type, value: object, path: str) -> object:
    if not isinstance(value, dict):
        raise _wrong(path, "a map", value)
    values = {}
    for field in _SCHEMAS[cls]:
        item = value.get(field.name, MISSING)
        if item is not MISSING:
            values[field.name] = field.read(item, f"{path}.{field.name}")
        elif field.default is MISSING:
            raise RemoteProtocolError(f"{path}.{field.name} is missing")
    return cls(**values)


_PLAIN: Final = {int: "an integer", bool: "true or false", str: "text", bytes: "bytes"}
"""The types of single values, and what errors call them."""


def _read_value(kind: type, value: object, path: str) -> object:
    if type(value) is not kind:  # not isinstance: True is an int to Python, not to the protocol
        raise _wrong(path, _PLAIN[kind], value)
    return value


def _read_int_or_none(value: object, path: str) -> object:
    return None if value is None else _read_value(int, value, path)


def _read_metadata(value: object, path: str) -> Metadata:
    if not isinstance(value, dict):
        raise _wrong(path, "a map", value)
    # msgpack lets binary keys through too.
    return tuple(
        (
            cast(str, _read_value(str, key, f"{path} key")),
            cast(str, _read_value(str, item, f"{path}.{limits.quoted(key)}")),
        )
        for key, item in value.items()
    )


def _reader(hint: Any) -> _Reader:
    """Return what reads a field of this annotation; records met on the way get their schema too."""
    if hint in _PLAIN:
        return functools.partial(_read_value, hint)
    if get_origin(hint) in (Union, types.UnionType) and set(get_args(hint)) == {int, type(None)}:
        return _read_int_or_none
    if hint == Metadata:
        return _read_metadata
    if get_origin(hint) is tuple:
        read_item = _reader(get_args(hint)[0])

        def read_items(value: object, path: str) -> tuple[object, ...]:
            if not isinstance(value, list):
                raise _wrong(path, "a list", value)
            return tuple(read_item(item, f"{path}[{i}]") for i, item in enumerate(value))

        return read_items
    if is_dataclass(hint):
        cls = cast(type, hint)
        _add_schema(cls)
        return lambda value, path: _read_record(cls, value, path)
    raise TypeError(f"no reader for {hint!r}")


def _add_schema(cls: type) -> None:
    hints: Mapping[str, Any] = get_type_hints(cls)
    _SCHEMAS[cls] = tuple(
        _Field(
            field.name,
            _reader(hints[field.name]),
            field.default,
            hints[field.name] == Metadata,
        )
        for field in fields(cast(Any, cls))
    )


def _wrong(path: str, wanted: str, value: object) -> RemoteProtocolError:
    return RemoteProtocolError(f"{path} must be {wanted}, got {limits.quoted(value)}")


_SCHEMAS: dict[type, tuple[_Field, ...]] = {}
for _cls in _TYPE_NAMES:
    _add_schema(_cls)
