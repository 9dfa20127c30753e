"""Mint a join token, let its owner in, and refuse everybody else.

You learn how a relay that strangers can reach knows who may enter: a signed token names one
room, one identity and what that identity may do there. The clock is an argument, so expiry is
shown at once.
"""

import base64
import json

from pica_protocol.messages import Join
from pica_server.limits import RefusalError
from pica_server.tokens import Admission, admit, mint, new_key_line, parse_keys

NOW = 1_800_000_000.0
HOUR_S = 3600.0

keys = parse_keys(new_key_line())  # a line of the file that `pica token --new-key` writes
admission = Admission(identity="ada", name="Ada", may_publish=True)
token = mint(keys, "standup", admission, now=NOW, lasts_s=HOUR_S)
claims = token.split(".")[1]
print(json.loads(base64.urlsafe_b64decode(claims + "=" * (-len(claims) % 4))))

join = Join(room="standup", name="Ada", tracks=(), token=token)
print(f"let in: {admit(keys, join, now=NOW + 60).identity}")

cases = {
    "too late": (keys, join, NOW + 2 * HOUR_S),
    "another room": (keys, Join(room="boardroom", name="Ada", tracks=(), token=token), NOW),
    "no token": (keys, Join(room="standup", name="Ada", tracks=()), NOW),
    "another key": (parse_keys(new_key_line()), join, NOW),
}
for what, (ring, request, now) in cases.items():
    try:
        admit(ring, request, now=now)
    except RefusalError as error:
        print(f"{what}: {error}")
    else:
        raise AssertionError(what)
