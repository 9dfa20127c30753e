"""The bar that a render shows on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def rendering_bar(console: Console, frames: int) -> Iterator[Callable[[int, int], None]]:
    """Show how many frames are done and how long the others will take; nothing without a terminal.

    Yields what to call with frames done and frames in all.
    """
    columns = (
        TextColumn("rendering"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("render", total=frames)
        yield lambda done, total: bar.update(task, completed=done, total=total)
