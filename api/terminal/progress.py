"""Progress bars on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


def bar(console: Console, *texts: str, transient: bool = False) -> Progress:
    """Return a progress bar that counts."""
    before, *behind = texts or ("{task.description}",)
    counted = (SpinnerColumn(), TextColumn(before), BarColumn(), MofNCompleteColumn())
    return Progress(*counted, *map(TextColumn, behind), TimeElapsedColumn(), console=console, transient=transient)


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar for a while; yield what moves it."""
    with bar(Console(stderr=True), what, transient=True) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
