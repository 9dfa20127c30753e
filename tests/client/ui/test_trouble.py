"""Errors of joining in a person's words: each with a remedy, the raw one kept as details."""

from __future__ import annotations

import asyncio
import errno
import socket
import ssl

import pytest

from pica_client.errors import (
    AvatarLookupError,
    OptionError,
    RelayRefusedError,
    RelayUnreachableError,
    SourceError,
)
from pica_client.transport.config import LinkConfig
from pica_client.transport.link import Link
from pica_client.ui.join_form import REFUSALS, explain
from pica_protocol.errors import CloseCode, is_worth_retrying

pytestmark = pytest.mark.unit

# What a client cannot cause by joining, or what is tried again without a word.
NEVER_AT_THE_FORM = {
    CloseCode.NORMAL,
    CloseCode.PROTOCOL_ERROR,
    CloseCode.INVALID_TEXT,
    CloseCode.MESSAGE_TOO_BIG,
    CloseCode.MALFORMED,
    CloseCode.UNEXPECTED_MESSAGE,
    CloseCode.FOREIGN_STREAM,
    CloseCode.UNFIT_FILE,
    CloseCode.STORE_FULL,
}


def caused(error: Exception, cause: BaseException) -> Exception:
    error.__cause__ = cause
    return error


def test_every_close_code_that_ends_a_join_has_words_and_a_remedy() -> None:
    final = {code for code in CloseCode if not is_worth_retrying(code)} - NEVER_AT_THE_FORM
    assert final <= REFUSALS.keys()
    for what, remedy in REFUSALS.values():
        assert what.endswith(".")
        assert remedy.endswith(".")


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        (ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed"), "Nothing runs"),
        (OSError("Multiple exceptions: [Errno 111] a, [Errno 111] b"), "Nothing runs"),
        (PermissionError(errno.EPERM, "Operation not permitted"), "does not allow"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), "does not lead"),
        (socket.gaierror(-2, "Name or service not known"), "no computer of that name"),
        (ssl.SSLCertVerificationError("self-signed"), "certificate is not trusted"),
        (ssl.SSLError("wrong version number"), "does not encrypt"),
        (EOFError("stream ended"), "not a PiCA relay"),
        (TimeoutError(), "No relay answers"),
    ],
)
def test_what_the_network_says_is_put_into_words(cause: Exception, said: str) -> None:
    middle = caused(RelayUnreachableError("inner"), cause)
    trouble = explain(caused(RelayUnreachableError("no relay answers at ws://x"), middle))
    assert said in trouble.what
    assert trouble.remedy
    assert trouble.details == "no relay answers at ws://x"
    assert "Errno" not in trouble.what + trouble.remedy


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RelayRefusedError("said no (code 4011)", code=4011), "valid token"),
        (RelayRefusedError("said no (code 4999)", code=4999), "The relay said no"),
        (RelayRefusedError("answers HTTP 404, not as a relay"), "not a PiCA relay"),
        (SourceError("take.csv: no such file"), "cannot be read"),
        (AvatarLookupError("avatar 'x' is unknown"), "not on this computer"),
        (OptionError("name must not be empty"), "enter your name"),
        (OptionError("ca-file x: No such file"), "CA file cannot be used"),
        (RuntimeError("boom"), "did not work"),
    ],
)
def test_errors_of_joining_are_put_into_words(error: Exception, said: str) -> None:
    trouble = explain(error)
    assert said in trouble.what
    assert trouble.remedy
    assert trouble.details == str(error)


def test_an_error_that_is_in_words_already_has_no_details() -> None:
    trouble = explain(OptionError("something must be said"))
    assert (trouble.what, trouble.details) == ("something must be said", "")


def test_a_port_where_nothing_listens_is_told_apart_from_silence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    link = Link(LinkConfig(url=f"ws://127.0.0.1:{port}", connect_timeout_s=0.2))
    with pytest.raises(RelayUnreachableError) as caught:
        asyncio.run(link.run())
    assert "Nothing runs" in explain(caught.value).what
