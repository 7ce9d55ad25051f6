"""A study: cases drawn by seeds, kept as they come, and the tables that are made of all of them.

A case is plain JSON values. It is appended to ``--out`` as soon as it is there, a line each, and what is there is not
run again.
"""

from __future__ import annotations

import argparse
import json
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from bench.report import Part, ResultTable, ended, say
from bench.scores import Cluster, figures_table

Case = Mapping[str, Any]
Key = tuple[Any, ...]


def _nothing(_parser: argparse.ArgumentParser) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Study:
    """What makes the cases of a study and what is said of them.

    Attributes:
        cases: Yields the cases that were asked for and are not done, None for one that failed.
        parts: Of the page; the study falls short where a table of it does.
        line: Of a case that has just come.
        rows: Names of what the study has a case of for every seed.
        seeds: By default.
        key: Names of what tells one case from another.
        command: That writes the page, from all cases.
        page: Its name where it is not that of the study.
        published: Numbers of a case against the truth, which share their errors with those of no other case; their
            figures are shown by row.
    """

    name: str
    title: str
    about: str
    cases: Callable[[argparse.Namespace, Collection[Key]], Iterator[Case | None]]
    parts: Callable[[Sequence[Case]], Sequence[Part]]
    line: Callable[[Case], str]
    rows: Collection[str] = ()
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    separator: str = ","
    seeds: str = "0"
    key: tuple[str, ...] = ("row", "seed")
    options: Callable[[argparse.ArgumentParser], None] = _nothing
    command: Callable[[Sequence[Case]], str] | None = None
    page: str = ""
    published: Callable[[Case], Cluster] | None = None

    def run(self, arguments: Sequence[str]) -> int:
        """Run what was asked for; return 1 when a row falls short or a case fails."""
        options = self._options(arguments)
        by_key, failed = {self.key_of(case): case for case in stored_cases(options.out, self.key)}, 0
        options.out.parent.mkdir(parents=True, exist_ok=True)
        for made in () if options.print_only else self.cases(options, frozenset(by_key)):
            if made is None:
                failed += 1
                continue
            text = json.dumps(made)
            case = json.loads(text)
            by_key[self.key_of(case)] = case
            with options.out.open("a", encoding="utf-8") as file:
                file.write(f"{text}\n")
            say(self.line(case))
        command, cases = None, list(by_key.values())
        if options.write_docs:
            command = self.command(cases) if self.command else f"python -m bench {self.name} --write-docs"
        parts = [*self.parts(cases), *self._figures(cases)]
        return int(bool(ended(parts, self.page or self.name, self.title, command) or failed))

    def _figures(self, cases: Sequence[Case]) -> Iterator[ResultTable]:
        """Yield the figures of the published numbers by what tells cases apart but for the seed."""
        if self.published is None:
            return
        names = [name for name in self.key if name != "seed"]
        groups: dict[str, list[Cluster]] = {}
        for case in cases:
            groups.setdefault(", ".join(str(case[name]) for name in names), []).append(self.published(case))
        yield figures_table("Published numbers against the truth", groups.items())

    def key_of(self, case: Case) -> Key:
        """Return what tells a case from another."""
        return tuple(case[name] for name in self.key)

    def _options(self, arguments: Sequence[str]) -> argparse.Namespace:
        parser = argparse.ArgumentParser(prog=f"python -m bench {self.name}", description=self.about)
        parser.add_argument("--seeds", type=seeds_of, default=self.seeds, help=f"as in 0-19 or 0,3; {self.seeds}")
        if self.rows:
            known = one_of(self.rows, self.separator, self.groups)
            parser.add_argument("--rows", type=known, default=list(self.rows), help="names; default: all")
        out = Path("bench-results", f"{self.name}.jsonl")
        parser.add_argument("--out", type=Path, default=out, help="lines of JSON; what is there is not run again")
        parser.add_argument("--print-only", action="store_true", help="print the tables of what --out holds")
        parser.add_argument("--write-docs", action="store_true", help=f"write docs/results/{self.page or self.name}.md")
        self.options(parser)
        return parser.parse_args(arguments)


def stored_cases(path: Path, key: Sequence[str]) -> list[Case]:
    """Return the cases of a file, the last of each key; none where there is no file."""
    if not path.exists():
        return []
    every = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return list({tuple(case[name] for name in key): case for case in every}.values())


def seeds_of(text: str) -> list[int]:
    """Return the seeds of ``0-19``, ``3`` or ``0,3,7``."""
    seeds: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


def one_of(known: Collection[str], separator: str = ",", groups: Mapping[str, Sequence[str]] = {}) -> Any:  # noqa: ANN401 - a type of argparse
    """Return what reads names with separators between; the name of a group stands for its members."""

    def names(text: str) -> list[str]:
        words = [word.strip() for word in text.split(separator)]
        chosen = [name for word in words for name in groups.get(word, (word,))]
        unknown = [name for name in chosen if name not in known]
        if unknown:
            listed = ", ".join((*known, *groups))
            raise argparse.ArgumentTypeError(f"no {', '.join(unknown)}; there are {listed}")
        return chosen

    return names


def in_processes(work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], workers: int = 1) -> Iterator[Any]:
    """Yield what ``work`` returns for each task, each in a new process; None for one that failed, which is printed."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        futures = {pool.submit(work, *task): task for task in tasks}
        for done, future in enumerate(as_completed(futures), start=1):
            try:
                made = future.result()
            except Exception as error:  # noqa: BLE001 - one case that fails must not cost the hour before it
                say(f"FAILED {futures[future]}: {error!r}\n{''.join(traceback.format_exception(error))}")
                made = None
            say(f"{done} of {len(futures)}:")
            yield made
