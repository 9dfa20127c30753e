"""Payloads filled up to a few sizes, so that the size of a frame says less about the face in it.

    padded = payload | 80 | zeros

The least bucket that holds payload and mark is taken; above the largest, its next multiple. A
sender says with its key whether its payloads are padded.
"""

from typing import Final

from pica_client.e2ee.errors import MalformedFrameError
from pica_client.errors import OptionError

MAX_BUCKET: Final = 1024
"""The largest bucket: sealed, it still fits a frame."""
_MARK: Final = b"\x80"


def parse_buckets(text: str) -> tuple[int, ...]:
    """Read bucket sizes in bytes, as ``32,64,256``; ``off`` is none.

    Raises:
        OptionError: They are no numbers from 1 to `MAX_BUCKET` that grow.
    """
    if text == "off":
        return ()
    try:
        buckets = tuple(int(size) for size in text.split(","))
    except ValueError:
        buckets = ()
    if not buckets or list(buckets) != sorted({*buckets}) or not 1 <= buckets[0] <= MAX_BUCKET:
        buckets = ()
    if not buckets or buckets[-1] > MAX_BUCKET:
        raise OptionError(
            f"pad is {text!r}; it is off, or sizes in bytes that grow, 1 to {MAX_BUCKET}: 32,64,256"
        )
    return buckets


def pad(payload: bytes, buckets: tuple[int, ...], max_bytes: int) -> bytes:
    """Return a payload of fewer than ``max_bytes`` filled up to its bucket, never beyond those."""
    least = len(payload) + len(_MARK)
    size = next((bucket for bucket in buckets if least <= bucket), None)
    if size is None:
        size = -(-least // buckets[-1]) * buckets[-1]
    return (payload + _MARK).ljust(min(size, max_bytes), b"\0")


def unpad(padded: bytes) -> bytes:
    """Return what was padded.

    Raises:
        MalformedFrameError: There is no mark: its sender does not pad as it said.
    """
    payload = padded.rstrip(b"\0")
    if not payload.endswith(_MARK):
        raise MalformedFrameError("a padded payload without its mark")
    return payload[: -len(_MARK)]
