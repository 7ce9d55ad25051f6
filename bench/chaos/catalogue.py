"""The parts of the chaos run, in their order."""

from __future__ import annotations

from bench.chaos.part import ChaosPart


def parts() -> tuple[ChaosPart, ...]:
    """Return all parts; each imports what it needs when it runs."""
    return ()
