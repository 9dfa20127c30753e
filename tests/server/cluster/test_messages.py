"""What nodes read from each other: anything, without falling over it."""

import pytest

from pica_server.cluster.messages import decode_node_message, decode_record
from pica_server.errors import ClusterMessageError

pytestmark = pytest.mark.unit

NO_MESSAGES = {
    "a list as a key": b"\x91\x81\x90\xc0",
    "a map as a key": b"\x91\x81\x80\xc0",
    "an extension type": b"\x91\xd4\x05x",
    "a timestamp out of range": b"\x91\xc7\x0c\xff" + b"\xff" * 12,
    "lists in lists": b"\x91" * 5000,
    "a list of four thousand million": b"\xdd\xff\xff\xff\xff",
    "a member who is no bytes": b"\x94\x01\xa30-a\x91\x93\xa30-a\xa0\x80\x80",
    "a whisper that is no bytes": b"\x94\xa7whisper\xa1r\xa2p1\x80",
    "no text": b"\x91\xa3\xff\xfe\xfd",
}


@pytest.mark.parametrize("name", NO_MESSAGES)
def test_what_no_node_sends_is_refused_with_an_error_that_is_counted(name: str) -> None:
    for decode in (decode_record, decode_node_message):
        with pytest.raises(ClusterMessageError):
            decode(NO_MESSAGES[name])
