import base64
import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import jwt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.errors import CloseCode
from pica_protocol.invite import Invite, parse_link
from pica_protocol.messages import Join, Track
from pica_server.cli.token import TokenOptions, token
from pica_server.config import ConfigurationError
from pica_server.limits import RefusalError
from pica_server.tokens import (
    ANY_AVATAR,
    AUDIENCE,
    Admission,
    Keys,
    admin_scope,
    admit,
    load_keys,
    mint,
    new_key_line,
    parse_keys,
)

pytestmark = pytest.mark.unit

OLD, NEW = b"o" * 32, b"n" * 32
KEYS = {"old": OLD, "new": NEW}
NOW = 1_800_000_000.0
OWN, ANOTHER = "0f" * 32, "1e" * 32
ADA = Admission(identity="ada", name="Ada", avatars=(OWN,))
CLAIMS = {
    "aud": AUDIENCE,
    "sub": "ada",
    "room": "lobby",
    "nbf": NOW,
    "exp": NOW + 60,
    "publish": True,
    "subscribe": True,
    "avatars": [OWN],
}


def minted(admission: Admission = ADA, *, keys: Keys = KEYS) -> str:
    return mint(keys, "lobby", admission, now=NOW, lasts_s=60)


def join(token: str, *, room: str = "lobby", avatar: str | None = OWN) -> Join:
    tracks = () if avatar is None else (Track(kind="face", avatar=avatar),)
    return Join(room=room, name="n", tracks=tracks, token=token)


def signed(claims: object = None, *, key: bytes = NEW, key_id: object = "new") -> str:
    payload = CLAIMS if claims is None else claims
    return jwt.encode(payload, key, algorithm="HS256", headers={"kid": key_id})  # type: ignore[arg-type]


def test_a_token_says_who_its_owner_is_and_what_they_may() -> None:
    assert admit(KEYS, join(minted()), now=NOW) == ADA
    viewer = Admission(identity="bob", may_publish=False, avatars=())
    assert admit(KEYS, join(minted(viewer), avatar=None), now=NOW) == viewer


def test_an_admins_token_for_all_rooms_lets_nobody_into_one() -> None:
    operator = Admission(identity="op", may_admin=True)
    token = mint(KEYS, "*", operator, now=NOW, lasts_s=60)
    assert admin_scope(KEYS, token, now=NOW) == "*"
    with pytest.raises(RefusalError, match="another room"):
        admit(KEYS, join(token, avatar=None), now=NOW)
    with pytest.raises(ValueError, match="room must be"):
        mint(KEYS, "*", ADA, now=NOW, lasts_s=60)


def test_tokens_of_an_older_key_hold_until_it_is_removed() -> None:
    token = minted(keys={"old": OLD})
    assert admit(KEYS, join(token), now=NOW) == ADA
    with pytest.raises(RefusalError, match="a key that is not known here"):
        admit({"new": NEW}, join(token), now=NOW)


@pytest.mark.parametrize(
    ("now", "complaint"),
    [(NOW + 69, None), (NOW + 70, "has expired"), (NOW - 10, None), (NOW - 11, "not hold yet")],
)
def test_a_token_holds_for_its_time_with_ten_seconds_to_spare(
    now: float, complaint: str | None
) -> None:
    expected = pytest.raises(RefusalError, match=complaint) if complaint else None
    with expected or contextlib.nullcontext():
        admit(KEYS, join(minted()), now=now)


VIEWER = Admission(identity="bob", may_publish=False, avatars=(ANY_AVATAR,))


@pytest.mark.parametrize(
    ("ask", "complaint", "code"),
    [
        (lambda: admit_ada(room="boardroom"), "another room", CloseCode.UNAUTHORIZED),
        (lambda: admit_ada(avatar=ANOTHER), "does not let you wear this", CloseCode.FORBIDDEN),
        (lambda: admit_ada(VIEWER), "does not let you publish", CloseCode.FORBIDDEN),
        (lambda: admin_scope(KEYS, minted(), now=NOW), "let you manage", CloseCode.FORBIDDEN),
    ],
    ids=["room", "another's face", "track of a viewer", "manage"],
)
def test_a_token_opens_its_room_for_what_it_grants_alone(
    ask: Callable[[], object], complaint: str, code: CloseCode
) -> None:
    with pytest.raises(RefusalError, match=complaint) as caught:
        ask()
    assert caught.value.code == code


def admit_ada(admission: Admission = ADA, room: str = "lobby", avatar: str = OWN) -> Admission:
    return admit(KEYS, join(minted(admission), room=room, avatar=avatar), now=NOW)


def unsigned() -> str:
    def part(value: object) -> str:
        return base64.urlsafe_b64encode(json.dumps(value).encode()).rstrip(b"=").decode()

    return f"{part({'alg': 'none', 'kid': 'new'})}.{part(CLAIMS)}."


@pytest.mark.parametrize(
    "token",
    [
        "",
        "a.b.c",
        unsigned(),
        jwt.encode(CLAIMS, NEW * 2, algorithm="HS512", headers={"kid": "new"}),
        jwt.encode(CLAIMS, NEW, algorithm="HS256"),
        signed(key=OLD),
        signed(key_id="nobody"),
        signed({**CLAIMS, "aud": "another-service"}),
        signed({**CLAIMS, "sub": "../../etc"}),
        signed({**CLAIMS, "name": "\x1b[2J"}),
        signed({**CLAIMS, "avatars": "all"}),
        signed({**CLAIMS, "exp": 10**400}),
        signed({**CLAIMS, "exp": float("nan")}),
        signed({**CLAIMS, "nbf": True}),
        *(signed({k: v for k, v in CLAIMS.items() if k != name}) for name in list(CLAIMS)[:5]),
        minted()[:-4] + "AAAA",
    ],
)
def test_what_is_no_good_token_is_refused_without_being_quoted(token: str) -> None:
    with pytest.raises(RefusalError) as caught:
        admit(KEYS, join(token), now=NOW)
    assert caught.value.code == CloseCode.UNAUTHORIZED
    assert not token or token not in str(caught.value)


@pytest.mark.parametrize("grant", ["publish", "subscribe", "avatars"])
def test_a_grant_that_is_not_there_is_not_granted(grant: str) -> None:
    claims = {name: value for name, value in CLAIMS.items() if name != grant}
    admission = admit(KEYS, join(signed(claims), avatar=None), now=NOW)
    assert not {
        "publish": admission.may_publish,
        "subscribe": admission.may_subscribe,
        "avatars": admission.avatars,
    }[grant]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)


@given(st.sampled_from([*CLAIMS, "name", "admin", "iat"]), JSON)
def test_a_good_signature_under_wild_claims_lets_in_nobody_without_an_identity(
    claim: str, value: object
) -> None:
    with contextlib.suppress(RefusalError):
        assert admit(KEYS, join(signed({**CLAIMS, claim: value})), now=NOW).identity


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no key is in it"),
        ("k1", "line 1: write a key id and its secret"),
        ("k1 " + "A" * 20, "line 1: a secret has 32 bytes or more"),
        ("\nk1 " + "?" * 44, "line 2: a bad key id, or no base64url"),
        ("k1 " + "A" * 44 + "\nk1 " + "B" * 44, "line 2: key id k1 is there already"),
    ],
)
def test_a_bad_key_file_is_refused_with_its_line_and_without_its_secrets(
    text: str, complaint: str
) -> None:
    with pytest.raises(ConfigurationError, match=complaint) as caught:
        parse_keys(text)
    assert "AAAA" not in str(caught.value)


def test_a_key_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"--keys .*missing: No such file"):
        load_keys(tmp_path / "missing")


def test_the_command_makes_keys_and_mints_with_the_newest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "keys"
    first = token(TokenOptions(keys=path, new_key=True))["key_id"]
    second = token(TokenOptions(keys=path, new_key=True))["key_id"]
    assert path.stat().st_mode & 0o077 == 0
    result = token(TokenOptions(keys=path, room="r", identity="ada", avatars=("any",)))
    assert first != second == result["key_id"]
    assert capsys.readouterr().out.strip() == result["token"]
    admission = admit(load_keys(path), join(result["token"], room="r"), now=result["expires"] - 1)
    assert admission == Admission(identity="ada", avatars=(ANY_AVATAR,))


def test_a_key_is_added_to_a_file_whose_last_line_has_no_end(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    path.write_text(new_key_line() + "# an editor was here")
    first = token(TokenOptions(keys=path, new_key=True))["key_id"]
    path.write_text(path.read_text().rstrip())
    second = token(TokenOptions(keys=path, new_key=True))["key_id"]
    keys = load_keys(path)
    assert list(keys)[1:] == [first, second]


@pytest.mark.skipif(os.name != "posix", reason="files have no such modes")
def test_a_key_file_that_anybody_may_write_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "keys"
    token(TokenOptions(keys=path, new_key=True))
    path.chmod(0o602)
    with pytest.raises(ConfigurationError, match=r"--keys .*: anybody can write keys into it"):
        load_keys(path)
    path.chmod(0o644)
    assert load_keys(path)


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("identity", "", "identity must be"),
        ("identity", "a b", "identity must be"),
        ("room", "", "room must be"),
        ("name", "\n", "name must"),
        ("lasts_s", 0.0, "lasts_s must be in"),
        ("avatars", ("me",), "avatars must be SHA-256"),
        ("avatars", (OWN,) * 40, "the token has .* bytes, the limit is"),
    ],
)
def test_a_bad_option_of_the_command_is_refused_by_name(
    field: str, value: object, complaint: str, tmp_path: Path
) -> None:
    path = tmp_path / "keys"
    token(TokenOptions(keys=path, new_key=True))
    options = TokenOptions(**{"keys": path, "identity": "ada", field: value})  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match=complaint):
        token(options)


def test_the_largest_token_fits_a_join() -> None:
    avatars = tuple(f"{i:064x}" for i in range(14))
    admission = Admission(identity="i" * 64, name="\U0001f642" * 16, avatars=avatars)
    token = mint(KEYS, "r" * 64, admission, now=NOW, lasts_s=60)
    assert admit(KEYS, join(token, room="r" * 64, avatar=None), now=NOW) == admission


def test_an_invite_link_holds_relay_room_and_token(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "keys"
    token(TokenOptions(keys=path, new_key=True))
    options = TokenOptions(keys=path, room="r", identity="ada", link="wss://relay.example")
    result = token(options)
    assert capsys.readouterr().out.strip() == result["link"]
    assert parse_link(result["link"]) == Invite(
        url="wss://relay.example", room="r", token=result["token"]
    )
    with pytest.raises(ConfigurationError, match="--link: url 'http://x' is no relay address"):
        token(TokenOptions(keys=path, room="r", identity="ada", link="http://x"))
