"""One part of the chaos run: its name, what it does, how large it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.report import BenchRow


@dataclass(frozen=True, slots=True)
class ChaosSettings:
    """How a part runs.

    Attributes:
        size: Number of rounds, kills, files or connections.
        seed: Of all that is drawn.
        folder: An empty folder of its own.
    """

    size: int
    seed: int
    folder: Path


@dataclass(frozen=True, slots=True)
class ChaosPart:
    """A part of the chaos run.

    Attributes:
        name: On the command line.
        summary: What happens in it.
        size: Of the full run.
        short: Size of the form that the tests run.
        rows: Runs it and yields what was measured beside what is to be reached.
    """

    name: str
    summary: str
    size: int
    short: int
    rows: Callable[[ChaosSettings], Iterator[BenchRow]]
