"""Mutation testing of the decision paths: ``python -m bench mutants [--named] [--paths PART] [--most N] ...``.

Lists, in ``mutants.toml``. *Thresholds* are constants that decide whether a number is refused, published or how
wide its interval is, each with a change that matters; none may survive. *Paths* are the modules in which such
decisions are made: their mutants are made by cosmic-ray's operators, a seeded sample of them is run, and less than a
tenth may survive.

Left out are mutants that no test can or should see: a boundary (``<`` for ``<=``, which differ on no measured value),
numbers inside messages, decorators, and checks of our own (assertions, ``zip(strict=True)``). What else changes
nothing that is published stands under ``equivalent`` in ``mutants.toml``, each with its reason; these are printed and
not run.

Every mutant runs in a process of its own that is forked from one which has the libraries loaded; the source on disk is
never changed.
"""

from __future__ import annotations

import argparse
import importlib.abc
import importlib.machinery
import importlib.util
import os
import random
import signal
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import parso
from cosmic_ray.ast import get_ast, is_number
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator
from rich.console import Console
from rich.table import Table

HERE = Path(__file__).parent
ALLOWED = 0.10  # share of the mutants of the paths that may survive
SEED = 20_100
COUNTS = 100  # whole numbers below it change by one
OPERATORS = (
    "core/AddNot",
    "core/ReplaceAndWithOr",
    "core/ReplaceOrWithAnd",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceBreakWithContinue",
    "core/ReplaceContinueWithBreak",
    "core/ReplaceUnaryOperator_Delete_Not",
    "core/ReplaceComparisonOperator_Lt_GtE",
    "core/ReplaceComparisonOperator_LtE_Gt",
    "core/ReplaceComparisonOperator_Gt_LtE",
    "core/ReplaceComparisonOperator_GtE_Lt",
    "core/ReplaceComparisonOperator_Eq_NotEq",
    "core/ReplaceComparisonOperator_NotEq_Eq",
    "core/ReplaceComparisonOperator_Is_IsNot",
    "core/ReplaceComparisonOperator_IsNot_Is",
    "core/ReplaceBinaryOperator_Add_Sub",
    "core/ReplaceBinaryOperator_Sub_Add",
    "core/ReplaceBinaryOperator_Mul_Div",
    "core/ReplaceBinaryOperator_Div_Mul",
)
QUICK = ("-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-p", "no:xdist")
PURE = "tests/estimation/decisions"  # tests of pure functions, which need none of the fixtures above them
PRELOADED = (
    "numpy", "scipy.signal", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.sparse.linalg",
    "scipy.stats", "numba", "sqlalchemy.orm", "alembic.command", "psycopg", "fastapi", "pydantic",
    "pydantic_settings", "can", "cantools", "typer", "rich", "zstandard", "orjson", "pytest",
)  # fmt: skip


class ScaleNumber(Operator):
    """Halve and double a number: what moves a threshold by what matters, where plus or minus one would not."""

    factors = (0.5, 2.0)

    def mutation_positions(self, node: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401 - a node of parso
        """Yield the position of a number once for every factor; zero has no half."""
        if is_number(node) and not _in_message(node) and float(_number(node)) != 0.0:
            for _ in self.factors:
                yield (node.start_pos, node.end_pos)

    def mutate(self, node: Any, index: int) -> Any:  # noqa: ANN401 - nodes of parso
        """Return the number times one of the factors; a count, which is small and whole, one more or less."""
        value, factor = _number(node), self.factors[index]
        if isinstance(value, float):
            new: float = value * factor
        else:
            new = value + (1 if factor > 1 else -1) if value < COUNTS else round(value * factor)
        return parso.python.tree.Number(f" {new!r}", node.start_pos)

    @classmethod
    def examples(cls) -> tuple[()]:
        """Return none."""
        return ()


def _number(node: Any) -> float | int:  # noqa: ANN401 - a node of parso
    text = node.value.replace("_", "")
    return int(text, 0) if text.lower().startswith("0x") or text.isdigit() else float(text)


def _in_message(node: Any) -> bool:  # noqa: ANN401 - a node of parso
    while node is not None:
        if node.type in {"fstring", "fstring_expr", "subscript", "decorator"}:
            return True
        node = node.parent
    return False


@dataclass(frozen=True, slots=True)
class Mutant:
    """A changed source of one module, and the tests that should notice."""

    module: str  # path below the root
    what: str  # line and change, or the name of a threshold
    source: str
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant; ``noticed`` None where its tests did not even pass without it."""

    mutant: Mutant
    noticed: bool
    seconds: float


def main(arguments: Sequence[str]) -> int:
    """Run the mutants that were asked for; return 1 where too many survive."""
    options = _options(arguments)
    lists = tomllib.loads((HERE / "mutants.toml").read_text(encoding="utf-8"))
    console = Console(width=None if Console().is_terminal else 160)
    chosen = [] if options.paths_only else _thresholds(lists["threshold"], options.only)
    if not options.named:
        for entry in lists["path"]:
            if options.only in entry["module"]:
                chosen += _of_path(entry, lists["equivalent"], options.most)
    _print_equivalents(lists["equivalent"], options, console)
    for name in PRELOADED:
        importlib.import_module(name)
    broken = _failing_without_change({item.tests for item in chosen}, options)
    if broken:
        console.print(f"these tests fail without any change: {', '.join(sorted(broken))}")
        return 2
    outcomes = _run_all(chosen, options, console)
    return _report(outcomes, console)


def _thresholds(entries: Sequence[dict[str, Any]], only: str) -> list[Mutant]:
    found = []
    for entry in entries:
        source = Path(entry["module"]).read_text(encoding="utf-8")
        if source.count(entry["find"]) != 1:
            raise SystemExit(
                f"mutants.toml: {entry['find']!r} stands {source.count(entry['find'])} times in {entry['module']}"
            )
        if only in entry["module"] or only in entry["name"]:
            changed = source.replace(entry["find"], entry["replace"])
            found.append(Mutant(entry["module"], f"threshold: {entry['name']}", changed, tuple(entry["tests"])))
    return found


@dataclass(frozen=True, slots=True)
class _Place:
    operator: Operator
    occurrence: int
    line: int  # from 1
    change: str  # name of the operator; of a number also the old value and the new one


def _places(source: str) -> list[_Place]:
    """Return where a source can be changed, but for lines that decide nothing."""
    lines = source.splitlines()
    operators: list[tuple[str, Operator]] = [("ScaleNumber", ScaleNumber())]
    operators += [(name.removeprefix("core/"), get_operator(name)()) for name in OPERATORS]
    return [
        _Place(operator, occurrence, line, " ".join([name, *values]))
        for name, operator in operators
        for occurrence, (line, *values) in enumerate(_positions(source, operator))
        if _counts(lines[line - 1].strip(), name)
    ]


def _is_equivalent(place: _Place, lines: Sequence[str], entries: Sequence[dict[str, Any]]) -> bool:
    """Return whether an entry is about this place; ``ScaleNumber 2`` is about both changes of a 2."""
    return any(
        one["change"] in {place.change, place.change.partition(" -> ")[0]} and one["line"] in lines[place.line - 1]
        for one in entries
    )


def _print_equivalents(entries: Sequence[dict[str, Any]], options: argparse.Namespace, console: Console) -> None:
    """Print which mutants are left out; an entry that matches none is out of date."""
    if options.named:
        return
    for entry in entries:
        source = Path(entry["module"]).read_text(encoding="utf-8")
        count = sum(_is_equivalent(place, source.splitlines(), [entry]) for place in _places(source))
        if not count:
            raise SystemExit(f"mutants.toml: no {entry['change']} of {entry['line']!r} in {entry['module']}")
        if options.only in entry["module"]:
            text = f"left out: {entry['module']}: {count} x {entry['change']}: {entry['line']}: {entry['why']}"
            console.print(text, markup=False, highlight=False)


def _of_path(entry: dict[str, Any], equivalents: Sequence[dict[str, Any]], most: int) -> Iterator[Mutant]:
    """Yield the mutants of a module, a seeded sample of ``most`` where there are more."""
    source = Path(entry["module"]).read_text(encoding="utf-8")
    lines = source.splitlines()
    known = [one for one in equivalents if one["module"] == entry["module"]]
    places = [place for place in _places(source) if not _is_equivalent(place, lines, known)]
    if len(places) > most:
        places = random.Random(f"{SEED} {entry['module']}").sample(places, most)  # noqa: S311 - a sample
    for place in places:
        changed = MutationVisitor.mutate_code(source, place.operator, place.occurrence)
        if changed is not None and changed != source:
            what = f"line {place.line} {place.change}: {lines[place.line - 1].strip()}"
            yield Mutant(entry["module"], what, changed, tuple(entry["tests"]))


def _positions(source: str, operator: Operator) -> list[tuple[Any, ...]]:
    """Return the line of all that an operator can change, in its own order, and of a number how."""
    found: list[tuple[Any, ...]] = []

    def visit(node: Any) -> None:  # noqa: ANN401 - a node of parso
        for index, (start, _) in enumerate(operator.mutation_positions(node)):
            scaled = isinstance(operator, ScaleNumber)
            values = [f"{node.value} -> {operator.mutate(node, index).value.strip()}"] if scaled else []
            found.append((start[0], *values))
        for child in getattr(node, "children", ()):
            visit(child)

    visit(get_ast(source))
    return found


def _counts(text: str, operator: str) -> bool:
    """Return whether a change of a line decides: mistakes of ours have no tests, and decorators decide nothing."""
    if operator == "ReplaceTrueWithFalse" and "strict=True" in text:
        return False
    if operator == "ReplaceBinaryOperator_Mul_Div" and "*, " in text:  # the star before keyword parameters
        return False
    return "raise " not in text and not text.startswith(("assert ", '"""', "@", "*,"))


class _Changed(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Imports one module from a changed source."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = mutant.module.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        self.path, self.source = str(Path(mutant.module).resolve()), mutant.source

    def find_spec(self, fullname: str, path: object = None, target: ModuleType | None = None) -> Any:  # noqa: ANN401, ARG002 - importlib's
        """Find the one module."""
        return importlib.util.spec_from_loader(fullname, self, origin=self.path) if fullname == self.name else None

    def get_filename(self, fullname: str) -> str:  # noqa: ARG002 - importlib's
        """Return where the module would be."""
        return self.path

    def get_data(self, path: str | bytes) -> bytes:  # noqa: ARG002 - importlib's
        """Return the changed source."""
        return self.source.encode()

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002 - importlib's
        """Return the changed module, compiled; nothing is cached."""
        return compile(self.source, self.path, "exec", dont_inherit=True)


def _start(mutant: Mutant | None, tests: Sequence[str]) -> int:
    """Fork a process that runs tests with a change; return its number."""
    pid = os.fork()
    if pid:
        return pid
    os.setpgid(0, 0)
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    code = 1
    try:
        if mutant is not None:
            sys.meta_path.insert(0, _Changed(mutant))
        import pytest  # noqa: PLC0415 - in the child

        pure = all(test.startswith(f"{PURE}/") for test in tests)
        if pure:
            os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # half of the time of a mutant
            sys.path[:0] = [str(folder.resolve()) for folder in (Path(PURE).parent, Path(PURE).parent.parent)]
        code = int(pytest.main([*QUICK, *([f"--confcutdir={PURE}"] if pure else []), *tests]))
    except BaseException:  # noqa: BLE001 - a mutant that cannot even be imported has been noticed
        code = 1
    os._exit(code)


def _finished(pid: int, began: float, limit: float) -> int | None:
    """Return the exit code of a process, 1 where it took too long, None while it runs."""
    done, status = os.waitpid(pid, os.WNOHANG)
    if done:
        return os.waitstatus_to_exitcode(status)
    if time.monotonic() - began < limit:
        return None
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return 1


def _pool(
    tasks: Sequence[tuple[Mutant | None, tuple[str, ...]]], options: argparse.Namespace
) -> Iterator[tuple[int, int, float]]:
    """Run tasks, some at a time; yield (number of the task, exit code, seconds) as they end."""
    running: dict[int, tuple[int, float]] = {}
    waiting = list(enumerate(tasks))
    while waiting or running:
        while waiting and len(running) < options.workers:
            number, (mutant, tests) = waiting.pop(0)
            running[_start(mutant, tests)] = (number, time.monotonic())
        for pid, (number, began) in list(running.items()):
            code = _finished(pid, began, options.limit)
            if code is not None:
                del running[pid]
                yield number, code, time.monotonic() - began
        time.sleep(0.01)


def _failing_without_change(tests: set[tuple[str, ...]], options: argparse.Namespace) -> set[str]:
    ordered = sorted(tests)
    codes = _pool([(None, item) for item in ordered], options)
    return {" ".join(ordered[number]) for number, code, _ in codes if code != 0}


def _run_all(mutants: Sequence[Mutant], options: argparse.Namespace, console: Console) -> list[Outcome]:
    outcomes = []
    began = time.monotonic()
    for number, code, seconds in _pool([(item, item.tests) for item in mutants], options):
        outcome = Outcome(mutants[number], code != 0, seconds)
        outcomes.append(outcome)
        if not outcome.noticed:
            console.print(f"survives: {outcome.mutant.module}: {outcome.mutant.what}", markup=False, highlight=False)
        if len(outcomes) % 25 == 0:
            passed = (time.monotonic() - began) / 60
            console.print(f"{len(outcomes)} of {len(mutants)} mutants, {passed:.1f} min", highlight=False)
    return outcomes


def _report(outcomes: Sequence[Outcome], console: Console) -> int:
    table = Table("module", "mutants", "survive", "share", title="mutants of the decision paths", title_justify="left")
    named = [item for item in outcomes if item.mutant.what.startswith("threshold")]
    others = [item for item in outcomes if not item.mutant.what.startswith("threshold")]
    for module in sorted({item.mutant.module for item in others}):
        _row(table, module, [item for item in others if item.mutant.module == module])
    if others:
        _row(table, "all paths", others)
    if named:
        _row(table, "named thresholds", named)
    console.print(table)
    share = sum(not item.noticed for item in others) / len(others) if others else 0.0
    return 1 if share >= ALLOWED or any(not item.noticed for item in named) else 0


def _row(table: Table, name: str, outcomes: Sequence[Outcome]) -> None:
    left = sum(not item.noticed for item in outcomes)
    table.add_row(name, str(len(outcomes)), str(left), f"{left / len(outcomes):.1%}")


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--named", action="store_true", help="the named thresholds alone")
    parser.add_argument("--paths-only", action="store_true", help="the decision paths alone")
    parser.add_argument("--only", default="", help="modules or thresholds whose name holds this")
    parser.add_argument("--most", type=int, default=40, help="mutants of a module at most, a seeded sample; default 40")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds after which a mutant counts as noticed")
    return parser.parse_args(arguments)
