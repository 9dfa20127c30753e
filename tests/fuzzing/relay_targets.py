"""More to throw damaged messages at: the relay without its sockets, and its tokens."""

from __future__ import annotations

import json
import random
import re
from typing import Any, Final

import jwt

from fuzzing.corpus import CORPUS, FACE, VOICE, media, to_relay
from fuzzing.meter import Meter
from fuzzing.mutator import INTEGERS, TEXTS, Mutator
from fuzzing.targets import expect, refusal
from pica_protocol.client_session import ClientSession
from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.messages import Hello, Join, Track
from pica_protocol.session import State
from pica_server.auth.tokens import (
    ALGORITHM,
    ANY_AVATAR,
    AUDIENCE,
    Admission,
    KeyRing,
    admit,
    mint,
)
from pica_server.config.relay import LimitsConfig, RelayConfig
from pica_server.errors import AdmissionError
from pica_server.room.connection import Connection
from pica_server.room.hub import Hub

SECRET: Final = bytes(range(32))
KEYS: Final = KeyRing({"old": SECRET[::-1], "new": SECRET})
NOW_UNIX: Final = 1_800_000_000.0
AVATAR: Final = "0f" * 32

_CONFIG: Final = RelayConfig(
    room_capacity=4,
    max_connections=9,
    handshake_timeout_s=5.0,
    limits=LimitsConfig(
        messages_per_s=8.0,
        bytes_per_s=8000.0,
        joins_per_s=1.0,
        joins_burst=12.0,
        connections_per_address=2,
    ),
)


class _Healthy:
    """A peer that behaves, and notices whatever it should not be told."""

    def __init__(self, hub: Hub, name: str, token: str, now: float) -> None:
        self.hub = hub
        self.connection = hub.connect(now)
        self.session = ClientSession(room="lobby", name=name, tracks=(FACE,), now=now, token=token)
        self.frames: list[Frame] = []
        self.speak(now)
        self.listen(now)
        expect(self.session.state is State.JOINED, "a healthy peer cannot join:", name)

    def speak(self, now: float) -> None:
        for data in self.session.messages_to_send(now):
            self.hub.receive(self.connection, data, now)

    def listen(self, now: float) -> None:
        while (message := self.hub.take(self.connection, now)) is not None:
            self.hub.sent(self.connection, message, now)
            events = self.session.receive_data(message.data, now)
            self.frames += [event for event in events if isinstance(event, Frame)]
        expect(self.connection.closed is None, "a healthy peer was closed:", self.connection.closed)
        expect(self.session.closed is None, "a healthy peer had to go:", self.session.closed)


def hub(rng: random.Random, meter: Meter) -> None:
    """Hostile connections in the room of two healthy peers, and beside it."""
    has_keys = rng.random() < 0.5
    secrets: list[str] = []

    def new_secret() -> str:
        secrets.append(f"{rng.getrandbits(128):032x}")
        return secrets[-1]

    relay = Hub(
        _CONFIG,
        (lambda join: admit(KEYS, join, now=NOW_UNIX)) if has_keys else None,
        new_secret=new_secret,
    )
    now = 100.0
    ada, bob = (_Healthy(relay, name, _token(name), now) for name in ("ada", "bob"))
    ada.listen(now)
    mutator = Mutator(rng, CORPUS)
    hostile: list[Connection] = []
    plans: dict[Connection, list[bytes]] = {}
    for step in range(120):
        now += rng.choice((0.0, 0.0, 0.001, 0.02, 0.3))
        if len(hostile) < 8 and rng.random() < 0.3:
            connection = meter.call(relay.connect, now, rng.choice(("", "192.0.2.7")))
            _note(connection, meter, was_open=True, is_damaged=False)
            hostile.append(connection)
            plans[connection] = _plan(rng, has_keys, secrets, stream=rng.randrange(1, 9))
        if hostile:
            connection = rng.choice(hostile)
            plan = plans[connection]
            data = plan.pop(0) if plan else media(rng, rng.randrange(1, 9))
            # Whoever is not let in is not looked at for long: let half of them be.
            is_damaged = rng.random() < (0.15 if plan else 0.6)
            if is_damaged:
                data = mutator.mutate(data)
            was_open = connection.closed is None
            meter.call(relay.receive, connection, data, now)
            _note(connection, meter, was_open=was_open, is_damaged=is_damaged)
            if rng.random() < 0.03 or connection.closed is not None:
                relay.disconnect(connection, rng.randrange(5000), "\x00", now)
                hostile.remove(connection)
            elif rng.random() < 0.3:
                while (message := relay.take(connection, now)) is not None:
                    relay.sent(connection, message, now)
        if rng.random() < 0.05:
            _administer(rng, relay, now)
        if step % 8 == 0:
            for healthy in (ada, bob):
                healthy.session.send_frame(bytes([step]), captured_us=step)
                healthy.speak(now)
                num = len(bob.frames)
                for listener in (ada, bob):
                    listener.listen(now)
                if healthy is ada:
                    own = [f for f in bob.frames[num:] if f.stream == ada.session.tracks[0].stream]
                    expect(len(own) == 1, "a frame was lost between healthy peers:", step)
        for listener in (ada, bob):
            listener.listen(now)
        when = relay.next_timer()
        if when is not None and when <= now:
            relay.handle_timer(now)
        relay.take_ready()
        waiting = relay.num_waiting_control_bytes
        expect(waiting <= 12 * _CONFIG.max_control_bytes, "control without a bound:", waiting)
    for healthy in (ada, bob):
        relay.disconnect(healthy.connection, CloseCode.NORMAL, "", now)
    for connection in hostile:
        relay.disconnect(connection, CloseCode.CONNECTION_LOST, "", now)
    expect(relay.num_connections == 0, "connections that nobody has:", relay.num_connections)
    relay.handle_timer(now + _CONFIG.resume_grace_s + 1)
    left = (relay.num_connections, relay.num_rooms, relay.num_waiting_frames)
    expect(left == (0, 0, 0), "not everything was cleared up:", left)


def _administer(rng: random.Random, relay: Hub, now: float) -> None:
    """Do to the room of strangers alone what an admin may do."""
    attic = relay.room("attic")
    peers = [] if attic is None else [peer.peer_id for peer in attic.peers]
    if attic is None:
        return
    match rng.randrange(4):
        case 0:
            relay.moderation.remove(attic, rng.choice([*peers, "p1"]), now)
        case 1:
            who = f"eve{rng.randrange(3)}"
            relay.moderation.bar(attic, who, is_barred=rng.random() < 0.5, now=now)
        case _:
            relay.moderation.mute(attic, rng.randrange(1, 9), is_muted=rng.random() < 0.5, now=now)


def _plan(rng: random.Random, has_keys: bool, secrets: list[str], stream: int) -> list[bytes]:
    room = rng.choice(("lobby", "lobby", "attic"))
    # Its own, one that was good once, or somebody else's.
    resume = rng.choice(secrets) if secrets and rng.random() < 0.5 else ""
    token = _token(f"eve{rng.randrange(3)}", room) if has_keys and rng.random() < 0.9 else ""
    join = Join(
        room=room,
        name="Eve",
        tracks=rng.choice(((), (FACE,), (FACE,), (FACE, VOICE), (VOICE,) * 4)),
        token=token,
        resumable=rng.random() < 0.7,
        resume=resume,
    )
    plan = [encode_message(Hello()), encode_message(join)]
    return plan + to_relay(rng, room=room, stream=stream)[2:]


def _note(connection: Connection, meter: Meter, *, was_open: bool, is_damaged: bool) -> None:
    closed = connection.closed
    outcome = "accepted" if closed is None or closed.is_remote else refusal(closed.code)
    meter.note(outcome if was_open else "ignored after the end", is_damaged=is_damaged)


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
