"""How settings of benches are spelled on the command line, lists as one word, and their limits."""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Annotated, Any

from cyclopts import Parameter, Token

from pica_client.errors import OptionError


def _listed(kind: Callable[[str], Any], metavar: str, between: str = ",") -> Parameter:
    def read(_type: object, tokens: Sequence[Token]) -> tuple[Any, ...]:
        text = tokens[0].value
        try:
            return tuple(kind(part.strip()) for part in text.split(between) if part.strip())
        except ValueError as error:
            raise ValueError(f"{text!r} is given; write numbers with commas") from error

    def show(values: tuple[Any, ...]) -> str:
        return between.join(f"{value}".removesuffix(".0") for value in values)

    return Parameter(converter=read, n_tokens=1, metavar=metavar, show_default=show)


Floats = Annotated[tuple[float, ...], _listed(float, "NUMBERS")]
Ints = Annotated[tuple[int, ...], _listed(int, "NUMBERS")]
Words = Annotated[tuple[str, ...], _listed(str, "NAMES")]
Arguments = Annotated[tuple[str, ...], _listed(str, "ARGUMENTS", between=" ")]


def check_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names that an option does not have.

    Raises:
        OptionError: Names it, and those that are known.
    """
    for name in names:
        if name not in known:
            raise OptionError(f"{option} {name!r} is unknown; known are {', '.join(known)}")
