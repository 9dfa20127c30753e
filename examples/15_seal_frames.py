"""Seal a frame end to end, open it, and see that nothing of it can be changed on the way.

You learn what the relay does not see. A payload is encrypted in the manner of SFrame (RFC 9605);
the header stays readable, and is authenticated: a frame moved to another stream or time does not
open.
"""

import os
from dataclasses import replace

from pica_client.e2ee.frames import derive_key, open_, seal
from pica_client.errors import SealError
from pica_protocol.frames import Frame, clear_header

key = derive_key(os.urandom(16), key_id=0)
frame = Frame(stream=7, sequence=41, captured_us=1_000_000, payload=b"a face")
sealed = seal(frame.payload, clear_header(frame), key, counter=41)
print(f"{len(frame.payload)} bytes of payload, {len(sealed)} sealed: {sealed.hex()}")
assert open_(sealed, clear_header(frame), key) == frame.payload

other = derive_key(os.urandom(16), key_id=0)
attempts = {
    "a flipped bit": (bytes([*sealed[:-1], sealed[-1] ^ 1]), clear_header(frame), key),
    "another stream": (sealed, clear_header(replace(frame, stream=8)), key),
    "another time": (sealed, clear_header(replace(frame, captured_us=2_000_000)), key),
    "another key": (sealed, clear_header(frame), other),
}
for what, arguments in attempts.items():
    try:
        open_(*arguments)
    except SealError as error:
        print(f"{what}: {type(error).__name__}")
    else:
        raise AssertionError(what)
