"""Run benches: ``python -m bench [NAME ...] [OPTION ...]``; ``python -m bench NAME --help`` shows what each has."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

os.environ.setdefault("TREADWATCH_ACCESS", "open")  # the services of the bench are on loopback
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

DEFAULT = ("contact", "estimation", "trend", "en15302")
OF_A_FLEET = (
    *(
        "logs",
        "new_window",
        "stored",
        "pipeline",
        "section_runs",
        "workers",
        "chunks",
        "sustained",
        "fleet_sizes",
        "idle",
    ),
)
NAMES = (
    *DEFAULT,
    *("section", "world", "vehicles", "refusals", "rivals", "signatures", "surveys", "adhesion", "rails", "dampers"),
    *("flats", "steps", "limits"),
    *OF_A_FLEET,
    *("api", "feed", "page", "fuzz", "chaos", "mutants", "house"),
)
GROUPS = {"fleet": OF_A_FLEET}
"""What a fleet costs, of more than an hour."""

MODULES = {
    "fleet_sizes": "growth",
    "section_runs": "growth",
    "sustained": "workers",
    "chaos": "chaos.run",
}


def main() -> int:
    """Run what was asked for, whatever falls short; return 1 where something does."""
    arguments = sys.argv[1:]
    names: list[str] = []
    while arguments and arguments[0] in {*NAMES, *GROUPS}:
        names += GROUPS.get(arguments[0], (arguments[0],))
        del arguments[0]
        if names[-1] == "chaos":  # what follows are its parts
            break
    if not names and arguments:
        sys.stderr.write(f"usage: python -m bench [{' | '.join((*NAMES, *GROUPS))}] ...\n")
        return 2
    return max(bench(name)(arguments) for name in names or DEFAULT)


def bench(name: str) -> Callable[[Sequence[str]], int]:
    """Return what runs a bench."""
    module = import_module(f"bench.{MODULES.get(name, name)}")
    found: Callable[[Sequence[str]], int] = next(
        (one.run for one in getattr(module, "BENCHES", ()) if one.name == name), getattr(module, "main", None)
    )
    return found


if __name__ == "__main__":
    sys.exit(main())
