"""Who may enter: join tokens, signed by the operator, checked here. Times are arguments.

A token is a JWT (RFC 7519) signed with HMAC-SHA256 under a key that the relay knows by its id, and
nothing else: the algorithm is pinned, whatever the token says. It names one room and one identity,
what that identity may do there, and which avatars it may wear, so that no peer puts on another
person's face. It is checked when its owner joins; a connection outlives it. Keys are rotated by
keeping the old one in the file until its last token has expired.
"""

import base64
import binascii
import os
import secrets
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jwt

from pica_protocol.errors import CloseCode
from pica_protocol.limits import (
    MAX_PASS_BYTES,
    check_name,
    check_token,
    is_avatar_id,
    quoted,
    text_of_file,
)
from pica_protocol.messages import Join
from pica_server.config import ConfigurationError
from pica_server.limits import RefusalError

ALGORITHM: Final = "HS256"
AUDIENCE: Final = "pica-relay"
ANY_AVATAR: Final = "*"
ANY_ROOM: Final = "*"
"""Stands for all rooms in an admin's token for ``GET /rooms``; it opens no room."""
LEEWAY_S: Final = 10.0
"""How far the clocks of minter and relay may differ (chosen)."""
MIN_SECRET_BYTES: Final = 32
"""A secret is as long as the hash (RFC 7518 3.2)."""
MAX_LASTS_S: Final = 100 * 365 * 86_400
"""A hundred years: no token opens a room for longer."""
_MAX_TIME_S: Final = 2.0**53
"""Seconds since 1970 that a float still counts one by one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Admission:
    """What a peer may do in the room that it joins."""

    identity: str = ""
    """The identity that the token proves; empty without tokens."""
    name: str = ""
    """What they are called; empty: as they like."""
    may_publish: bool = True
    may_subscribe: bool = True
    avatars: tuple[str, ...] = (ANY_AVATAR,)
    """Avatar ids they may wear; ``*`` is any."""
    may_admin: bool = False
    """Whether they may moderate the room, and see who is in it over HTTP."""


Keys = dict[str, bytes]
"""Secrets that tokens are signed with, by the id of the key, the newest last."""


def parse_keys(text: str) -> Keys:
    """Read a key file: one key on each line, its id and its secret in base64url; ``#`` begins a
    comment.

    Raises:
        ConfigurationError: A line is wrong, two keys share an id, or there is none; names the line,
            never a secret.
    """
    keys: Keys = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != 2:
            raise ConfigurationError(f"line {number}: write a key id and its secret")
        key_id, encoded = words
        try:
            check_token("the key id", key_id)
            padded = encoded + "=" * (-len(encoded) % 4)
            secret = base64.b64decode(padded, altchars=b"-_", validate=True)
        except (ValueError, binascii.Error) as error:
            raise ConfigurationError(f"line {number}: a bad key id, or no base64url") from error
        if len(secret) < MIN_SECRET_BYTES:
            raise ConfigurationError(
                f"line {number}: a secret has {MIN_SECRET_BYTES} bytes or more"
            )
        if key_id in keys:
            raise ConfigurationError(f"line {number}: key id {key_id} is there already")
        keys[key_id] = secret
    if not keys:
        raise ConfigurationError("no key is in it; `pica token --keys FILE --new-key` makes one")
    return keys


def new_key_line() -> str:
    """Return the line of a new key."""
    encoded = base64.urlsafe_b64encode(secrets.token_bytes(MIN_SECRET_BYTES)).rstrip(b"=")
    return f"k{secrets.token_hex(4)} {encoded.decode()}\n"


def newest_of(keys: Keys) -> str:
    """Return the id of the key that signs."""
    return next(reversed(keys))


def load_keys(path: Path) -> Keys:
    """Read a key file.

    Raises:
        ConfigurationError: It cannot be read, or used, or anybody may write their own key into it.
    """
    try:
        if os.name == "posix" and path.stat().st_mode & stat.S_IWOTH:
            raise ConfigurationError("anybody can write keys into it: make new ones, for its owner")
        return parse_keys(text_of_file(path.read_bytes()))
    except (OSError, UnicodeDecodeError) as error:
        what = error.strerror if isinstance(error, OSError) else "no text"
        raise ConfigurationError(f"--keys {path}: {what}") from error
    except ConfigurationError as error:
        raise ConfigurationError(f"--keys {path}: {error}") from error


def mint(keys: Keys, room: str, admission: Admission, *, now: float, lasts_s: float) -> str:
    """Return a token for one room, signed with the newest key.

    Args:
        room: Where it lets its owner in; ``*`` is the rooms that an admin may manage, all of them.
        now: Seconds since 1970.
        lasts_s: Seconds from ``now`` until it ends.

    Raises:
        ValueError: A field is out of its limits.
    """
    if room != ANY_ROOM or not admission.may_admin:
        check_token("room", room)
    check_token("identity", admission.identity)
    if admission.name:
        check_name("name", admission.name)
    for avatar in admission.avatars:
        if avatar != ANY_AVATAR and not is_avatar_id(avatar):
            raise ValueError(f"avatars must be SHA-256 in hexadecimal or *, got {quoted(avatar)}")
    if not 0 < lasts_s <= MAX_LASTS_S:
        raise ValueError(f"lasts_s must be in 0..{MAX_LASTS_S:g}, got {lasts_s:g}")
    claims: dict[str, Any] = {
        "aud": AUDIENCE,
        "sub": admission.identity,
        "room": room,
        "iat": int(now),
        "nbf": int(now),
        "exp": int(now + lasts_s),
        "publish": admission.may_publish,
        "subscribe": admission.may_subscribe,
        "avatars": list(admission.avatars),
    }
    if admission.name:
        claims["name"] = admission.name
    if admission.may_admin:
        claims["admin"] = True
    key_id = newest_of(keys)
    token = jwt.encode(claims, keys[key_id], algorithm=ALGORITHM, headers={"kid": key_id})
    if len(token) > MAX_PASS_BYTES:
        raise ValueError(f"the token has {len(token)} bytes, the limit is {MAX_PASS_BYTES}")
    return token


def admit(keys: Keys, join: Join, *, now: float) -> Admission:
    """Check the token of a join, and what the join asks for against it; ``now`` is Unix time.

    Raises:
        RefusalError: ``UNAUTHORIZED`` without a token that is good here and now, ``FORBIDDEN``
            for what the token does not grant; the text does not quote the token.
    """
    claims = _claims_that_hold(keys, join.token, now)
    if claims.get("room") != join.room:
        raise _unauthorized("the token is for another room")
    name = claims.get("name", "")
    try:
        identity = claims["sub"]
        check_token("identity", identity)
        if name:
            check_name("name", name)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise _unauthorized("the token names no identity") from error
    admission = Admission(
        identity=identity,
        name=name,
        may_publish=claims.get("publish") is True,
        may_subscribe=claims.get("subscribe") is True,
        avatars=tuple(_avatars(claims)),
        may_admin=claims.get("admin") is True,
    )
    if join.tracks:
        worn = [track.avatar for track in join.tracks if track.avatar]
        _check_publishing(admission.may_publish, admission.avatars, worn)
    return admission


def _check_publishing(may_publish: bool, allowed: Sequence[str], worn: Sequence[str]) -> None:
    if not may_publish:
        raise RefusalError("the token does not let you publish", CloseCode.FORBIDDEN)
    if ANY_AVATAR not in allowed and not set(worn) <= set(allowed):
        raise RefusalError("the token does not let you wear this", CloseCode.FORBIDDEN)


def admit_upload(keys: Keys, token: str, avatar: str, *, now: float) -> None:
    """Check that a token, for any room, lets its owner publish with an avatar, and so upload it;
    raises as `admit`."""
    claims = _claims_that_hold(keys, token, now)
    _check_publishing(claims.get("publish") is True, _avatars(claims), [avatar])


def admin_scope(keys: Keys, token: str, *, now: float) -> str:
    """Return the room that an admin's token is for, or ``ANY_ROOM``; ``now`` is Unix time.

    Raises:
        RefusalError: ``UNAUTHORIZED`` without a token that is good now, ``FORBIDDEN`` for one
            that is no admin's; the text does not quote it.
    """
    claims = _claims_that_hold(keys, token, now)
    room = claims.get("room")
    if claims.get("admin") is not True or not isinstance(room, str):
        raise RefusalError("the token does not let you manage rooms", CloseCode.FORBIDDEN)
    return room


def _avatars(claims: Mapping[str, Any]) -> list[str]:
    avatars = claims.get("avatars", [])
    if not isinstance(avatars, list) or not all(isinstance(item, str) for item in avatars):
        raise _unauthorized("the token's avatars are no list of text")
    return avatars


def _claims_that_hold(keys: Keys, token: str, now: float) -> Mapping[str, Any]:
    if not token:
        raise _unauthorized("this relay wants a token")
    try:
        key_id = jwt.get_unverified_header(token).get("kid")
        secret = keys.get(key_id) if isinstance(key_id, str) else None
        if secret is None:
            raise _unauthorized("the token is signed with a key that is not known here")
        claims: Mapping[str, Any] = jwt.decode(
            token,
            secret,
            algorithms=[ALGORITHM],
            audience=AUDIENCE,
            # Times are checked against an argument, not against a clock in there.
            options={
                "require": ["aud", "sub", "nbf", "exp"],
                "verify_exp": False,
                "verify_nbf": False,
                "verify_iat": False,
            },
        )
    # What a stranger wrote goes through base64 and JSON before the signature is looked at.
    except (jwt.InvalidTokenError, ValueError, TypeError, RecursionError) as error:
        raise _unauthorized("the token is not valid") from error
    begins_s, ends_s = _number(claims, "nbf"), _number(claims, "exp")
    if now < begins_s - LEEWAY_S:
        raise _unauthorized("the token does not hold yet")
    if now >= ends_s + LEEWAY_S:
        raise _unauthorized("the token has expired")
    return claims


def _number(claims: Mapping[str, Any], field: str) -> float:
    value: Any = claims.get(field)
    # JSON has numbers that no float holds, and Python reads NaN: a token that never expires.
    if type(value) not in (int, float) or not -_MAX_TIME_S < value < _MAX_TIME_S:
        raise _unauthorized("the token is not valid")
    return float(value)


def _unauthorized(reason: str) -> RefusalError:
    return RefusalError(reason, CloseCode.UNAUTHORIZED)
