"""Where expressions come from: one tracker, file format or generator per module."""

from pica_client.sources.registry import open_source, start_later
from pica_client.sources.source import LiveSource, Recording, Source

__all__ = ["LiveSource", "Recording", "Source", "open_source", "start_later"]
