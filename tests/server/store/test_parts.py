"""The store's pure parts: limits and slots."""

import pytest

from pica_core.avatar import file as avatar_file
from pica_server.config.relay import StoreConfig
from pica_server.errors import ConfigurationError, StoreRefusalError
from pica_server.store.store import Slots

pytestmark = pytest.mark.unit


def test_no_file_is_taken_that_receivers_would_not() -> None:
    assert StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES)
    with pytest.raises(ConfigurationError, match=r"--store\.largest-bytes"):
        StoreConfig(largest_bytes=avatar_file.MAX_FILE_BYTES + 1)


def test_slots_are_limited_in_all_and_for_each_address_and_come_back() -> None:
    slots = Slots(limit=3, per_address=2)
    with slots.taken("a"), slots.taken("a"):
        with pytest.raises(StoreRefusalError), slots.taken("a"):
            pass
        with slots.taken("b"), pytest.raises(StoreRefusalError), slots.taken("c"):
            pass
    with slots.taken(""), slots.taken(""), slots.taken(""):
        pass
