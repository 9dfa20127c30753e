"""Giving a relay the file of an avatar, so that those without it can see its wearer.

It goes over a websocket of its own, beside the call: in small messages, and with a small buffer in
the kernel, because the faces share the way up with it.
"""

import asyncio
import hashlib
import random
import socket
import unicodedata
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from pica_client.errors import (
    ClientError,
    OptionError,
    RelayError,
    RelayRefusedError,
    RelayUnreachableError,
)
from pica_client.transport.connect import LinkConfig, open_websocket
from pica_core.avatar.file import MAX_FILE_BYTES, read_bytes, shipped_avatar_files
from pica_core.errors import AvatarFileError
from pica_protocol.codec import MAX_CHUNK_BYTES, decode_message, encode_chunk, encode_message
from pica_protocol.errors import WORTH_RETRYING, CloseCode, RemoteProtocolError
from pica_protocol.messages import STORE_SUBPROTOCOL, Bye, Message, Offer, Ready, Stored

SEND_BUFFER_BYTES = 16 * 2**10
"""What the kernel may hold of a file, which it may double (chosen: 130 ms of a link with 1 Mbit/s
up, through which a face goes too; with 50 ms there and back still 2.5 Mbit/s)."""
ANSWER_TIMEOUT_S = 60.0
"""Seconds for the relay to check a file that has come whole; others may be before it."""
MAX_ATTEMPTS = 6
NO_STORE = "the relay does not answer as a store"


async def push_avatar(url: str, link: LinkConfig, path: Path, identity: str) -> bool:
    """Give a relay, ws:// or wss://, an avatar's file, unless it has it; return True if it is new
    there.

    Args:
        link: Has the token that allows to wear this avatar, and the certificates for wss://.
        identity: The SHA-256 of the file, in hexadecimal.

    Raises:
        RelayUnreachableError: The relay is not there, or cannot take it now.
        RelayRefusedError: It keeps no avatars, or does not take this one.
        AvatarFileError: The file cannot be read.
        OptionError: The token file, or the certificates, cannot be read.
    """
    data = await asyncio.to_thread(read_bytes, path, MAX_FILE_BYTES)
    token = link.read_token()
    websocket = await open_websocket(url, STORE_SUBPROTOCOL)
    try:
        raw = websocket.transport.get_extra_info("socket")
        if raw is not None and raw.family in (socket.AF_INET, socket.AF_INET6):
            with suppress(OSError):
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        offer = Offer(sha256=identity, size=len(data), token=token)
        await websocket.send(encode_message(offer))
        answer = await _answer(websocket)
        if isinstance(answer, Ready):
            for begin in range(0, len(data), MAX_CHUNK_BYTES):
                piece = data[begin : begin + MAX_CHUNK_BYTES]
                await websocket.send(encode_chunk(piece))
            answer = await _answer(websocket)
        if not isinstance(answer, Stored):
            raise RelayRefusedError(NO_STORE)
        await websocket.close()
        return answer.is_new
    except ConnectionClosed as error:
        # Why, stands in what it said before it closed.
        code = websocket.close_code or CloseCode.CONNECTION_LOST
        raise _refused(code, websocket.close_reason or "the connection broke") from error
    except RemoteProtocolError as error:
        raise RelayRefusedError(NO_STORE) from error
    finally:
        websocket.transport.abort()  # in case we are cancelled


async def _answer(websocket: ClientConnection) -> Message:
    try:
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            data = await websocket.recv()
    except TimeoutError as error:
        raise RelayUnreachableError("the relay does not answer") from error
    if isinstance(data, str):
        raise RelayRefusedError(NO_STORE)
    message = decode_message(data)
    if isinstance(message, Bye):
        raise _refused(message.code, message.reason or "the relay said no")
    return message


def _refused(code: int, reason: str) -> RelayError:
    kind = RelayUnreachableError if code in WORTH_RETRYING else RelayRefusedError
    return kind(reason)


class AvatarGiver:
    """Gives our avatar to whatever relay we are at; `begin` it after each join.

    Attributes:
        outcome: For the statistics: ``""`` until something happened, then ``known``, ``given`` or
            why not.
    """

    def __init__(
        self, link: LinkConfig, path: Path, identity: str, say: Callable[[str], None]
    ) -> None:
        """Prepare to give a file, see `push_avatar`; `say` takes a line for the user."""
        self.outcome = ""
        self._url = ""
        self._link, self._path, self._identity = link, path, identity
        self._say = say
        self._task: asyncio.Task[None] | None = None

    def begin(self, url: str) -> None:
        """Give it to the relay at an address, in the background; what is under way goes there with
        its next attempt."""
        self._url = url
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._give(), name="avatar push")

    async def close(self) -> None:
        """Stop giving it."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _give(self) -> None:
        for attempt in range(1, MAX_ATTEMPTS + 1):
            try:
                is_new = await push_avatar(self._url, self._link, self._path, self._identity)
            except (AvatarFileError, ClientError) as error:
                if isinstance(error, RelayUnreachableError) and attempt < MAX_ATTEMPTS:
                    await asyncio.sleep(random.uniform(0.125, 0.25) * 2**attempt)
                    continue
                if self.outcome != str(error):
                    self._say(f"the relay did not get this avatar's file ({error}): others need it")
                self.outcome = str(error)
            else:
                if is_new:
                    self._say("gave the relay this avatar's file, for those who do not have it")
                self.outcome = "given" if is_new else "known"
            return


GiveAvatar = Literal["auto", "yes", "no"]
"""Whether the relay gets the file. auto: unless it ships with this package, so that everybody has
it, or faces are encrypted: the relay's operator can look at the file."""
SALT = "pica"
"""Goes before a name that is hashed (chosen: so the names of this documentation's examples fall on
as many shipped avatars)."""


def giver_of(
    path: Path,
    identity: str,
    link: LinkConfig,
    say: Callable[[str], None],
    give: GiveAvatar = "auto",
) -> AvatarGiver | None:
    """What gives the file of an avatar to the relays of a link; None if it is not to be given."""
    is_needed = link.secret_file is None and path not in shipped_avatar_files()
    if give == "no" or (give == "auto" and not is_needed):
        return None
    return AvatarGiver(link, path, identity, say)


def avatar_by_name(name: str, avatars: Sequence[str]) -> str:
    """The default avatar of a name: the one that is called so, else one that is always the same for
    the name, and seldom that of another name.

    Raises:
        OptionError: There are none.
    """
    if not avatars:
        raise OptionError("no avatar ships with this package; name one with --avatar FILE")
    text = unicodedata.normalize("NFC", name).casefold().strip()
    number = int.from_bytes(hashlib.sha256((SALT + text).encode()).digest()[:8])
    return text if text in avatars else avatars[number % len(avatars)]
