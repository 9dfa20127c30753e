"""Finding another way to the relay while the one that is there has fallen silent."""

import asyncio
from typing import Final

from pica_client.errors import ClientError
from pica_client.transport.connect import RelayWebsocket
from pica_client.transport.dialer import Dialer
from pica_client.transport.silence import Silence
from pica_client.transport.timers import time_after

LOOK_TIMEOUT_S: Final = 3.0
"""Longest wait for a websocket beside another (chosen: the kernel asks again after 1 s)."""


class Lookout:
    """Watches the websockets of a link one after the other.

    Attributes:
        num_looks: How often another way was tried.
    """

    def __init__(self, dialer: Dialer, silence: Silence) -> None:
        self.num_looks = 0
        self._dialer = dialer
        self._silence = silence
        self._successor: RelayWebsocket | None = None

    @property
    def has_successor(self) -> bool:
        """Whether there is a websocket to go on with."""
        return self._successor is not None

    def take_successor(self) -> RelayWebsocket | None:
        """Take the websocket to go on with, if there is one; who does not use it aborts it."""
        successor, self._successor = self._successor, None
        return successor

    async def watch(self, websocket: RelayWebsocket) -> None:
        """Return once the websocket was ended: there is a successor, or it was silent for long."""
        loop, silence = asyncio.get_running_loop(), self._silence
        silence.begin()
        while self._successor is None:
            due_s = silence.next_timer(websocket.heard_s)
            await asyncio.sleep(due_s - loop.time())
            match silence.handle_timer(websocket.heard_s, time_after(due_s)):
                case "ask":
                    websocket.ask()
                case "look":
                    await self._look(websocket)
                case "give up":
                    break
        websocket.transport.abort()

    async def _look(self, websocket: RelayWebsocket) -> None:
        """Open a websocket beside one that is silent; it succeeds it unless that speaks again."""
        loop, heard_s = asyncio.get_running_loop(), websocket.heard_s
        self.num_looks += 1
        url = self._dialer.addresses.beside(self._silence.num_looks - 1)
        try:
            other = await self._dialer.open(url, loop.time() + LOOK_TIMEOUT_S)
        except ClientError:
            self._silence.note_failed(loop.time())
            return
        if websocket.heard_s != heard_s:
            other.transport.abort()
            return
        self._successor, self._dialer.addresses.current = other, url
