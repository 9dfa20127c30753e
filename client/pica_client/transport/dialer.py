"""Opening websockets to the relays of a link: to the next in turn, or to a certain one."""

import asyncio
import logging
from collections.abc import Awaitable, Callable

from websockets.exceptions import InvalidHandshake

from pica_client.errors import RelayRefusedError, RelayUnreachableError
from pica_client.transport.addresses import Addresses
from pica_client.transport.connect import RelayWebsocket, refusal, trouble
from pica_protocol import SUBPROTOCOL

_log = logging.getLogger(__name__)

Connector = Callable[[str], Awaitable[RelayWebsocket]]


class Dialer:
    """Opens websockets.

    Attributes:
        addresses: Where to, in which order.
    """

    def __init__(self, urls: tuple[str, ...], connector: Connector) -> None:
        """Prepare; `connector` opens a websocket to an address, with the library's errors."""
        self.addresses = Addresses(urls)
        self._connector = connector

    async def open_next(self, deadline: float | None) -> RelayWebsocket:
        """Open one to the next address in turn.

        Args:
            deadline: When all addresses that are left in the round must have been tried.

        Raises:
            RelayUnreachableError: Nobody answers there.
            RelayRefusedError: What answers there is no relay for us.
            OptionError: The file of certificates to trust cannot be read.
        """
        url = self.addresses.take()
        if deadline is not None:
            now = asyncio.get_running_loop().time()
            deadline = now + (deadline - now) / (1 + self.addresses.num_left)
        return await self.open(url, deadline)

    async def open(self, url: str, deadline: float | None) -> RelayWebsocket:
        """Open one to an address, by `deadline` if there is one; raises as `open_next`."""
        try:
            async with asyncio.timeout_at(deadline):
                websocket = await self._connector(url)
        except (OSError, TimeoutError, InvalidHandshake, EOFError) as error:
            _log.debug("relay not reached", extra={"error": type(error).__name__})
            if (reason := refusal(error)) is None:
                raise RelayUnreachableError(trouble(error, url)) from error
            raise RelayRefusedError(f"{url}: {reason}") from error
        if websocket.subprotocol != SUBPROTOCOL:
            websocket.transport.abort()
            raise RelayRefusedError(f"{url}: a websocket server that does not speak {SUBPROTOCOL}")
        return websocket
