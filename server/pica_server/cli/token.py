"""`pica token`: admit a person to one room of a relay."""

import errno
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pica_protocol.invite import Invite, make_link
from pica_server.config import ConfigurationError
from pica_server.tokens import ANY_AVATAR, Admission, load_keys, mint, new_key_line, newest_of


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenOptions:
    """Options of `pica token`."""

    keys: Path
    """The relay's key file; the newest key signs."""
    new_key: bool = False
    """Add a key to the file, which is made if need be, instead of minting. The relay takes tokens
    of all keys in the file; remove an old one when its last token has expired."""
    room: str = "lobby"
    """The room that the token opens; with --admin, * for all rooms."""
    identity: str = ""
    """The owner's identity: 1 to 64 of A-Z a-z 0-9 _ . - ; of two with it the newer one stays."""
    name: str = ""
    """What they are called in the room; empty: as they like."""
    lasts_s: float = 3600.0
    """Seconds until it expires: an hour, unless said otherwise. It is checked when its owner
    joins."""
    publish: bool = True
    """Whether they may send a face."""
    subscribe: bool = True
    """Whether they get the faces of others."""
    admin: bool = False
    """Whether they may remove, mute and bar others in the room, and ask for GET /rooms."""
    avatars: tuple[str, ...] = ()
    """Ids of the avatars they may wear, see `pica avatar info`; `any` for any."""
    link: str = ""
    """Address of the relay, ws:// or wss://: print an invite link instead, which fills in the form
    of `pica view`."""


def token(options: TokenOptions) -> dict[str, Any]:
    """Mint a join token for a relay that runs with --keys, and print it; or make a key.

    The token is all that is needed to come in: hand it over on a private way.

    Raises:
        ConfigurationError: The key file cannot be used, or a field is out of its limits.
    """
    if options.new_key:
        return _add_key(options.keys)
    keys = load_keys(options.keys)
    admission = Admission(
        identity=options.identity,
        name=options.name,
        may_publish=options.publish,
        may_subscribe=options.subscribe,
        may_admin=options.admin,
        avatars=(ANY_AVATAR,) if options.avatars == ("any",) else options.avatars,
    )
    now = time.time()
    try:
        minted = mint(keys, options.room, admission, now=now, lasts_s=options.lasts_s)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    result = {"token": minted, "key_id": newest_of(keys), "expires": int(now + options.lasts_s)}
    until = time.strftime("%Y-%m-%d %H:%M", time.localtime(now + options.lasts_s))
    print(f"it opens {options.room} until {until}; --lasts-s says how long", file=sys.stderr)
    if not options.link:
        print(minted)
        return result
    try:
        link = make_link(Invite(url=options.link, room=options.room, token=minted))
    except ValueError as error:
        raise ConfigurationError(f"--link: {error}") from error
    print(link)
    return {**result, "link": link}


def _add_key(path: Path) -> dict[str, Any]:
    try:
        # An editor may have left the last key without an end of its line.
        is_torn = path.exists() and path.read_bytes()[-1:] not in (b"", b"\n")
        line = "\n" * is_torn + new_key_line()
        # Readable for its owner alone from its first moment.
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "ab", 0) as file:
            before = file.tell()
            try:
                if file.write(line.encode()) != len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:  # half a key would spoil the file
                file.truncate(before)
                if not before:
                    path.unlink()
                raise
    except OSError as error:
        raise ConfigurationError(f"--keys {path}: {error.strerror}") from error
    key_id = newest_of(load_keys(path))
    print(f"added key {key_id} to {path}; start the relay again to use it", file=sys.stderr)
    return {"key_id": key_id, "file": str(path)}
