"""How settings of benches are spelled on the command line, lists as one word, and their limits."""

from collections.abc import Callable, Collection, Iterable
from typing import Annotated, Any

from tyro.constructors import PrimitiveConstructorSpec

from pica_client.errors import OptionError


def _listed(
    kind: Callable[[str], Any], metavar: str, between: str = ","
) -> PrimitiveConstructorSpec[Any]:
    def read(words: list[str]) -> tuple[Any, ...]:
        try:
            return tuple(kind(part.strip()) for part in words[0].split(between) if part.strip())
        except ValueError as error:
            raise ValueError(f"{words[0]!r} is given; write numbers with commas") from error

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda values: [
            between.join(f"{value}".removesuffix(".0") for value in values)
        ],
    )


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
