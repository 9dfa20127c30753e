"""Where expressions come from: one tracker, file format or generator per module."""

from pica_client.sources.registry import open_source, start_later
from pica_client.sources.source import Recording, Source
from pica_client.sources.tracker import Tracker

__all__ = ["Recording", "Source", "Tracker", "open_source", "start_later"]
