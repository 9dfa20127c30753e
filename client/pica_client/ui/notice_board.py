"""Notices that stand for a few seconds, the latest below the others. Pure."""

from typing import Final, Literal, NamedTuple

NoticeTone = Literal["plain", "good", "warning", "alert", "accent"]
NOTICE_S: Final = 4.0
"""How long a notice stands."""
LOUD_NOTICE_S: Final = 8.0
"""The same for what should not be missed: a warning, an alert."""
MAX_NOTICES: Final = 3
"""Shown at once; one more drops the oldest."""


class Notice(NamedTuple):
    """One line, and how loud it is."""

    text: str
    tone: NoticeTone = "plain"


class NoticeBoard:
    """Keeps what is to be read."""

    def __init__(self) -> None:
        self._notices: list[tuple[Notice, float]] = []

    def add(self, notice: Notice, now: float) -> None:
        """Show a notice from `now` on, seconds; the same text again only stays longer."""
        lasts_s = LOUD_NOTICE_S if notice.tone in ("warning", "alert") else NOTICE_S
        others = [each for each in self._notices if each[0] != notice]
        self._notices = [*others, (notice, now + lasts_s)][-MAX_NOTICES:]

    def shown(self, now: float) -> tuple[Notice, ...]:
        """What is to be read at `now`, the oldest first."""
        self._notices = [each for each in self._notices if now < each[1]]
        return tuple(notice for notice, _ in self._notices)
