"""Who is who in a call, as far as names tell: which look like another's. Pure.

Names are compared as they look. Two are alike if they differ in nothing but case, spaces,
characters that leave no ink, and letters that are drawn the same way: a Cyrillic A, a one for an l.
What looks like what is Unicode's list (UTS 39, confusables.txt), as `confusable_homoglyphs` brings
it. Letters that merely resemble each other, as with and without an accent, are not alike.
"""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable
from functools import cache

from pica_protocol.limits import draws_nothing
from pica_protocol.messages import Peer

_SELF = ""
"""Stands for ourselves among the peer ids."""
_BARE_MARKS = re.compile("[\u034f\u17b4\u17b5\u180b-\u180f\ufe00-\ufe0f\U000e0100-\U000e01ef]")
"""Marks that leave no ink on their letter either: joiners and variation selectors."""


def name_warnings(peers: Iterable[Peer], own_name: str = "") -> dict[str, str]:
    """Look for names that are the same, or look the same, and warn of possible impersonation.

    Of those whose names are alike, one whose name alone is assured gets no warning.

    Args:
        peers: Everybody else in the room.
        own_name: Ours, as the others see it: names like ours are warned of too. Empty: unknown.

    Returns:
        By peer id a warning for people, in a few words; empty: the name is unique.
    """
    people = {peer.peer_id: peer for peer in peers}
    names = {_SELF: own_name} | {peer_id: peer.name for peer_id, peer in people.items()}
    bearers: dict[str, set[str]] = defaultdict(set)
    for peer_id, name in names.items():
        for look in _looks(name):
            bearers[look].add(peer_id)
    warnings = {}
    for peer_id, peer in people.items():
        alike = set[str]().union(*(bearers[look] for look in _looks(peer.name))) - {peer_id}
        assured = {other for other in alike - {_SELF} if people[other].is_name_assured}
        note = ""
        if _SELF in alike:
            note = "has your name" if peer.name == own_name else "looks like your name"
        elif alike and (assured or not peer.is_name_assured):
            other = names[min(assured or alike)]
            whose = f"the assured {other}" if assured else other
            note = f"not {whose}" if assured and not peer.is_name_assured else f"also {other}"
            if other != peer.name:
                note = f"looks like {whose}"
        warnings[peer_id] = note
    return warnings


@cache
def _look(character: str) -> str:
    """Return what stands for all characters that look like one."""
    # Read with the first name: 50 ms of a processor and 17 MB (measured).
    from confusable_homoglyphs.confusables import confusables_data

    def alike(text: str) -> list[str]:
        return [entry["c"] for entry in confusables_data.get(text, ())]

    # The list pairs each character with the one that stands for its kind, and that with all.
    return max([character, *alike(character)], key=lambda text: (len(alike(text)), text))


def _looks(name: str) -> set[str]:
    """Return what a name looks like: two names that share one of these are alike."""
    marked = _BARE_MARKS.sub("", unicodedata.normalize("NFKC", name))
    inked = [c for c in marked if not draws_nothing(c) or unicodedata.category(c)[0] == "M"]
    plain = "".join(inked)
    # A capital i looks like an l, and a small one is the same name: both are to be found.
    looks = ("".join(map(_look, plain)).casefold(), "".join(map(_look, plain.casefold())))
    return set(filter(None, looks))
