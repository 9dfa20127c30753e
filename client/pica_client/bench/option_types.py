"""How settings of benches are spelled on the command line: lists as one word, with commas."""

from collections.abc import Callable
from typing import Annotated, Any

from tyro.constructors import PrimitiveConstructorSpec


def _commas(kind: Callable[[str], Any], metavar: str) -> PrimitiveConstructorSpec[Any]:
    def read(words: list[str]) -> tuple[Any, ...]:
        try:
            return tuple(kind(part.strip()) for part in words[0].split(",") if part.strip())
        except ValueError as error:
            raise ValueError(f"{words[0]!r} is given; write numbers with commas") from error

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda values: [
            ",".join(f"{value}".removesuffix(".0") for value in values)
        ],
    )


Floats = Annotated[tuple[float, ...], _commas(float, "NUMBERS")]
Ints = Annotated[tuple[int, ...], _commas(int, "NUMBERS")]
Words = Annotated[tuple[str, ...], _commas(str, "NAMES")]
