"""More to throw damaged messages at: the tokens of a relay."""

from __future__ import annotations

import json
import random
import re
from typing import Any, Final

import jwt

from fuzzing.meter import Meter
from fuzzing.mutator import INTEGERS, TEXTS, Mutator
from fuzzing.targets import expect, refusal
from pica_protocol.errors import CloseCode
from pica_protocol.messages import Join, Track
from pica_server.auth.tokens import (
    ALGORITHM,
    ANY_AVATAR,
    AUDIENCE,
    Admission,
    KeyRing,
    admit,
    mint,
)
from pica_server.errors import AdmissionError

SECRET: Final = bytes(range(32))
KEYS: Final = KeyRing({"old": SECRET[::-1], "new": SECRET})
NOW_UNIX: Final = 1_800_000_000.0
AVATAR: Final = "0f" * 32


def _token(identity: str, room: str = "lobby", **grants: Any) -> str:
    admission = Admission(identity=identity, **grants)
    return mint(KEYS, room, admission, now=NOW_UNIX, lasts_s=60.0, starts_s=0.0)


def tokens(rng: random.Random, meter: Meter) -> None:
    """Damaged tokens, and signed ones whose claims are nonsense."""
    good = _token("eve", avatars=(AVATAR,))
    granted = admit(KEYS, Join(room="lobby", name="Eve", token=good), now=NOW_UNIX)
    mutator = Mutator(rng, [good.encode(), _token("bob", "attic").encode()])
    for _ in range(30):
        token = mutator.mutate_bytes(good.encode()).decode("latin-1")
        if rng.random() < 0.8:  # else few get past the first look
            token = re.sub(r"[^A-Za-z0-9_.-]", lambda _: rng.choice("Aa0_-."), token)
        _offer(token, meter, only=granted)
    for _ in range(20):
        _offer(_signed(rng, mutator), meter, only=None)


def _signed(rng: random.Random, mutator: Mutator) -> str:
    """Return a token that is signed rightly and says anything."""
    claims: dict[str, Any] = {
        "aud": AUDIENCE,
        "sub": "eve",
        "room": "lobby",
        "nbf": int(NOW_UNIX),
        "exp": int(NOW_UNIX) + 60,
        "publish": True,
        "subscribe": True,
        "avatars": [ANY_AVATAR],
        "name": "Eve",
    }
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice([*claims, "jti", "admin", "iss", "iat", "crit"])
        claims[name] = _weird_json(rng)
        if rng.random() < 0.1:
            del claims[name]
    header: dict[str, Any] = {"alg": ALGORITHM, "kid": rng.choice(("old", "new")), "typ": "JWT"}
    if rng.random() < 0.2:
        header[rng.choice(("alg", "kid", "typ", "crit", "jku", "b64"))] = _weird_json(rng)
    payload = json.dumps(claims).encode()
    if rng.random() < 0.1:
        payload = mutator.mutate_bytes(payload)
    secret = KEYS.secret("old" if header.get("kid") == "old" else "new")
    assert secret is not None
    signer = jwt.PyJWS().get_algorithm_by_name(ALGORITHM)
    parts = [jwt.utils.base64url_encode(part) for part in (json.dumps(header).encode(), payload)]
    signature = signer.sign(b".".join(parts), signer.prepare_key(secret))
    return b".".join([*parts, jwt.utils.base64url_encode(signature)]).decode()


def _weird_json(rng: random.Random) -> Any:
    match rng.randrange(7):
        case 0:
            return rng.choice((rng.choice(INTEGERS), rng.choice(INTEGERS), 10**400, -(10**400)))
        case 1:
            return rng.choice(TEXTS)
        case 2:
            return rng.choice((None, True, False, float("nan"), float("inf"), float("-inf"), 1e308))
        case 3:
            return rng.choice(([], {}, [[]], ["*", 1], {"a": 1}, [None], ["x"] * 1000))
        case 4:
            return [rng.choice(TEXTS)]
        case 5:
            return [rng.choice(INTEGERS)]
    nested: Any = 0
    for _ in range(rng.choice((5, 300))):
        nested = [nested]
    return nested


def _offer(token: str, meter: Meter, *, only: Admission | None) -> None:
    try:
        join = Join(room="lobby", name="Eve", token=token, tracks=(Track(kind="face"),))
    except ValueError:
        meter.note("refused MALFORMED")
        return
    try:
        admission = meter.call(admit, KEYS, join, now=NOW_UNIX)
    except AdmissionError as error:
        codes = (CloseCode.UNAUTHORIZED, CloseCode.FORBIDDEN)
        expect(error.code in codes, "an admission error with another code:", error.code)
        quotes = len(token) > 20 and token in str(error)
        expect(not quotes, "the error quotes the token:", str(error))
        meter.note(refusal(error.code))
        return
    expect(only is None or admission == only, "a damaged token gives other rights:", token)
    expect(bool(admission.identity), "let in without an identity:", token)
    meter.note("accepted")
