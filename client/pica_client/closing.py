"""What is closed at the end of a block."""

from typing import Self


class Closing:
    """Something that a ``with`` block closes at its end."""

    def close(self) -> object:
        """Give back what it holds."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
