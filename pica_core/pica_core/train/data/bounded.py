"""A memory of what was made, of bounded size."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")

MAX_ENTRIES = 2048
"""Entries of each memory: 0.8 MB a map or texture of 256 x 256."""


class Bounded(Generic[Key, Value]):
    """Values by key, made when they are first asked for; the least recently used go first."""

    def __init__(self, make: Callable[[Key], Value]) -> None:
        self._make = make
        self._values: OrderedDict[Key, Value] = OrderedDict()

    def __getitem__(self, key: Key) -> Value:
        if key not in self._values:
            self._values[key] = self._make(key)
            if len(self._values) > MAX_ENTRIES:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]
