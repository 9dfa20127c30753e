"""A bound for what TLS buffers, which both ends of a connection need."""

from typing import Any


def bound_tls_buffer(transport: Any) -> bool:
    """Let TLS, if there is any, write no further ahead than one message; return whether there is.

    The limits of a TLS transport of asyncio hold for what is not encrypted yet; the plain transport
    under it takes 64 KiB more, which is seconds of a slow reader's time. The standard library has
    no public way to it; a test notices when this one ends.
    """
    plain = getattr(getattr(transport, "_ssl_protocol", None), "_transport", None)
    if plain is not None:
        plain.set_write_buffer_limits(high=0)
    return plain is not None
