"""What to answer when somebody asks for a file of the store by HTTP (RFC 9110, 9111). Pure.

A file never changes: its name is its hash. So the entity tag is the hash, caches may keep it for
ever, and a range of it can be joined with what somebody got years ago.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Final

CACHE_CONTROL: Final = "public, max-age=31536000, immutable"
METHODS: Final = ("GET", "HEAD")

_RANGE = re.compile(r"bytes=\s*(\d{0,18})-(\d{0,18})\s*")


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """Status, headers, and which bytes of the file follow."""

    status: HTTPStatus
    headers: dict[str, str] = field(default_factory=dict)
    begin: int = 0
    end: int = 0
    text: str = ""
    """Instead of bytes of the file: for people."""


def answer_for(identity: str, size: int, asked: Mapping[str, str]) -> Answer:
    """Say what to answer to a GET of a file that is there; a HEAD gets the same without bytes.

    Several ranges at once, and ranges in other units, are answered with the whole file, as the
    standard allows.

    Args:
        identity: The file's SHA-256 in hexadecimal.
        size: Its length in bytes, above 0.
        asked: The request's ``Range``, ``If-Range`` and ``If-None-Match``, where it has them.
    """
    tag = f'"{identity}"'
    headers = {"ETag": tag, "Cache-Control": CACHE_CONTROL, "Accept-Ranges": "bytes"}
    # A weak tag is good enough for a cache (RFC 9110 13.1.2) but not for joining ranges (13.1.5).
    known = [each.strip().removeprefix("W/") for each in asked.get("If-None-Match", "").split(",")]
    if tag in known or "*" in known:
        return Answer(status=HTTPStatus.NOT_MODIFIED, headers=headers)
    headers |= {"Content-Type": "application/octet-stream", "X-Content-Type-Options": "nosniff"}
    wanted = None
    if (asked.get("If-Range") or tag) == tag:
        wanted = parse_range(asked.get("Range", ""), size)
    begin, end = wanted or (0, size)
    headers["Content-Length"] = str(end - begin)
    if wanted is None:
        return Answer(status=HTTPStatus.OK, headers=headers, end=end)
    if begin < end:
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
        return Answer(status=HTTPStatus.PARTIAL_CONTENT, headers=headers, begin=begin, end=end)
    headers["Content-Range"] = f"bytes */{size}"
    return refusal(
        HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, f"the file has {size} bytes", headers
    )


def parse_range(text: str, size: int) -> tuple[int, int] | None:
    """Read a ``Range`` header.

    Returns:
        First byte and the one behind the last, equal for a range that lies outside the file; None
        for what is no single range of bytes, and is to be ignored.
    """
    found = _RANGE.fullmatch(text)
    if found is None or not (found[1] or found[2]):
        return None
    if not found[1]:  # the last so many
        return max(size - int(found[2]), 0), size
    begin, last = int(found[1]), int(found[2] or size)
    if found[2] and last < begin:
        return None  # RFC 9110 14.1.1: such a range is invalid
    return min(begin, size), min(last + 1, size)


def refusal(status: HTTPStatus, text: str, headers: Mapping[str, str] | None = None) -> Answer:
    """Say no, in a line for people."""
    found = {"Cache-Control": "no-store", **(headers or {})}
    if status == HTTPStatus.METHOD_NOT_ALLOWED:
        found["Allow"] = ", ".join(METHODS)
    if status == HTTPStatus.SERVICE_UNAVAILABLE:
        found["Retry-After"] = "1"
    found |= {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text) + 1)}
    return Answer(status=status, headers=found, text=f"{text}\n")
