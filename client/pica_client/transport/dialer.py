"""Opening websockets to the relays of a link: to the next in turn, or to a certain one."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence

from pica_client.errors import RelayRefusedError, RelayUnreachableError
from pica_client.transport.connect import CONNECT_ERRORS, RelayWebsocket, refusal, trouble
from pica_protocol import SUBPROTOCOL

_log = logging.getLogger(__name__)

Connector = Callable[[str], Awaitable[RelayWebsocket]]


class Addresses:
    """The relays of a link, tried in order; between two rounds through all of them it waits.

    Attributes:
        current: The one that we are at, or try now.
    """

    def __init__(self, urls: Sequence[str]) -> None:
        """Begin with the first of them."""
        self.current = urls[0]
        self._urls = tuple(urls)
        self._round = list(urls)

    @property
    def num_left(self) -> int:
        """How many are to be tried before the round is over."""
        return len(self._round)

    def take(self) -> str:
        """Go on to the next of the round, of a new one if it is over."""
        if not self._round:
            self._round = list(self._urls)
        self.current = self._round.pop(0)
        return self.current

    def begin_with(self, url: str) -> None:
        """Begin a round with one of them, or with one that a relay has sent us to."""
        self._round = [url, *(other for other in self._urls if other != url)]

    def beside(self, index: int) -> str:
        """Return what is tried beside the current one, the time `index`: itself, then the others
        in order, and so on."""
        others = [url for url in self._urls if url != self.current]
        return [self.current, *others][index % (len(others) + 1)]


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
        """Open one to the next address in turn; all that are left in the round have to be tried by
        `deadline`.

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
        except CONNECT_ERRORS as error:
            _log.debug("relay not reached", extra={"error": type(error).__name__})
            if (reason := refusal(error)) is None:
                raise RelayUnreachableError(trouble(error, url)) from error
            raise RelayRefusedError(f"{url}: {reason}") from error
        if websocket.subprotocol != SUBPROTOCOL:
            websocket.transport.abort()
            raise RelayRefusedError(f"{url}: a websocket server that does not speak {SUBPROTOCOL}")
        return websocket
