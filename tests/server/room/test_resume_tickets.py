import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from helpers.members import counting_secrets
from pica_server.room.resume_tickets import ResumeTickets

pytestmark = pytest.mark.unit

GRACE_S = 10.0


def returns(grace_s: float = GRACE_S) -> ResumeTickets:
    return ResumeTickets(grace_s, counting_secrets())


def test_places_are_given_up_in_the_order_of_going_when_the_grace_is_over() -> None:
    places = returns()
    for peer_id in ("p1", "p2", "p3"):
        places.issue("lobby", peer_id)
    assert places.next_timer() is None
    places.go_away("p2", now=1.0)
    places.go_away("p1", now=2.0)
    assert places.next_timer() == 11.0
    assert places.take_expired(now=10.9) == []
    assert places.take_expired(now=12.0) == ["p2", "p1"]
    assert places.next_timer() is None


def test_without_a_grace_time_no_place_is_kept() -> None:
    places = returns(grace_s=0.0)
    assert places.issue("lobby", "p1") == ""
    assert not places.go_away("p1", now=0.0)
    assert places.redeem("lobby", "") is None


def test_the_secrets_themselves_are_not_kept() -> None:
    places = ResumeTickets(GRACE_S, lambda: "correct-horse-battery")
    places.issue("lobby", "p1")
    kept = [getattr(places, name) for name in vars(places)]
    assert "correct-horse" not in repr(kept)


class ReturnsMachine(RuleBasedStateMachine):
    """Against a table of who holds which secret, and since when they are away."""

    def __init__(self) -> None:
        super().__init__()
        self.places = returns()
        self.secrets: dict[str, str] = {}
        self.away: dict[str, float] = {}
        self.used: list[str] = []
        self.now = 0.0

    @rule(peer=st.sampled_from("abc"))
    def issue(self, peer: str) -> None:
        self.used.append(self.secrets.pop(peer, "none"))
        self.away.pop(peer, None)
        self.secrets[peer] = self.places.issue("lobby", peer)

    @rule(peer=st.sampled_from("abc"))
    def redeem(self, peer: str) -> None:
        secret = self.secrets.pop(peer, "none")
        assert self.places.redeem("lobby", secret) == (None if secret == "none" else peer)
        self.away.pop(peer, None)
        self.used.append(secret)

    @rule(peer=st.sampled_from("abc"))
    def go_away(self, peer: str) -> None:
        if peer not in self.away:
            assert self.places.go_away(peer, self.now) is (peer in self.secrets)
            if peer in self.secrets:
                self.away[peer] = self.now

    @rule(peer=st.sampled_from("abc"))
    def forget(self, peer: str) -> None:
        self.places.forget(peer)
        self.used.append(self.secrets.pop(peer, "none"))
        self.away.pop(peer, None)

    @rule(seconds=st.sampled_from((1.0, 4.0, 11.0)))
    def wait(self, seconds: float) -> None:
        self.now += seconds
        expected = [peer for peer, since in self.away.items() if since + GRACE_S <= self.now]
        assert self.places.take_expired(self.now) == expected
        for peer in expected:
            del self.away[peer]
            self.used.append(self.secrets.pop(peer))

    @invariant()
    def used_secrets_open_nothing(self) -> None:
        assert all(self.places.redeem("lobby", secret) is None for secret in self.used[-5:])

    @invariant()
    def the_timer_is_the_first_deadline(self) -> None:
        first = min(self.away.values(), default=None)
        assert self.places.next_timer() == (None if first is None else first + GRACE_S)


ReturnsMachine.TestCase.settings = settings(max_examples=80, stateful_step_count=30)
TestReturnsMachine = ReturnsMachine.TestCase
