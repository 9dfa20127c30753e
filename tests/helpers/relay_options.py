"""The settings of a relay as its command reads them, without starting it."""

from collections.abc import Mapping, Sequence

from pica_command.parsing import parse_words
from pica_command.profile import read_command
from pica_server.cli.relay import RelayOptions


def read_relay_options(words: Sequence[str], environment: Mapping[str, str]) -> RelayOptions:
    """Read words and variables; unknown ones and bad values raise."""

    def parse(words: Sequence[str]) -> RelayOptions:
        return parse_words(RelayOptions, words, prog="pica relay", description="")

    return read_command("relay", RelayOptions, words, environment, parse)[0]
