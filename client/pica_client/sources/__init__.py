"""Where expressions come from: one tracker, file format or generator per module."""

from pica_client.sources.live.tracker import Tracker
from pica_client.sources.registry import open_source, start_later
from pica_client.sources.source import Recording, Source

__all__ = ["Recording", "Source", "Tracker", "open_source", "start_later"]
