"""Print what the layout of the code costs its readers: ``python -m bench house [--list] [--root FOLDER]``.

Definitions, in the order of the table:

product lines, modules; bench lines
    Of the Python files of the four packages; of ``bench``.
loose modules
    Files directly in ``estimation/`` but ``__init__.py``.
long functions, complex functions
    Functions of the four packages of more than 50 lines without their docstring; functions anywhere in the repository
    of cyclomatic complexity over 10 by ruff, suppressed or not. Migrations are history and not counted.
loose numeric constants
    As ``bench/loose_constants.py`` defines them.
long files
    Python files of more than 400 lines, tests and benches included, migrations not.
files entered by one frame
    Files of the four packages of which a function runs while one recording of a known wheelset is received, windows
    are estimated, geometry, trend and alerts are refreshed, and the REST API is asked for all three
    (``bench/frame_trace.py``). Not counted, because the frame's data do not pass through them: the alignment job,
    values (``estimation/values``, files of which only special methods run) and infrastructure (``INFRASTRUCTURE``: the
    command line, settings, transactions, records of job runs, logs, HTTP without content). Two rows: to the geometry,
    the answer that the frame's own data end in, and to trend and alerts besides.
SQL statements
    Of each job, in one run of all over six windows of two wheelsets on a new database.
start
    CPU seconds (user and system) of the command line, median of five.
loose words
    Words of ``LOOSE_WORDS`` in Python and Markdown files, parts of identifiers included.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import resource
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from api.comparison.trial import deploy, receive, record
from api.factory import open_store
from api.pipeline import job_context
from bench.digests import SCENARIOS, command, environment_of, simulate
from bench.loose_constants import loose_constants
from bench.measuring import Stages
from estimation.values.runs import JobTrigger
from ingest.simulator.scenario_file import load_scenario

PACKAGES = ("api", "fleet_db", "ingest", "estimation")
SCREEN = 50
COMPLEXITY = 10
LONG_FILE = 400
STARTS = 5
LEASE_S = 60.0
CORE_JOBS = ("refresh_alignment", "estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts")
ALIGNMENT_JOB = "refresh_alignment"
API_START = "start of the REST API"
TO_GEOMETRY = ("ingest", "estimate_windows", "refresh_geometry", "/v1/wheelsets/{serial}/geometry")
LOOSE_WORDS = (
    *("told", "felt", "heard", "lies", "settle", "settles", "settled", "settling", "anew", "nought", "unless told"),
    *("by name", "passed over", "overtaken", "strays", "stray", "hurried", "spoken", "dealt to"),
)
WORD = re.compile(rf"(?<![a-z])({'|'.join(LOOSE_WORDS)})(?![a-z])", re.IGNORECASE)
MIGRATIONS = "versions"
"""Folder of the migrations: they carry the tables, and no logic."""

OWN_FILES = ("bench/house.py", "tests/bench/test_house.py")

INFRASTRUCTURE = re.compile(
    r"""(
      api/(cli|commands/.*|terminal/.*|factory|pipeline|serving|settings|rules_file|logs|metrics|services|job_runner|app|openapi/.*)\.py
    | api/(problems|times|contract|cursors|parameters|middleware)\.py
    | api/(http_server|head_requests|allowed_methods)\.py
    | fleet_db/(changes|locks|migrate|session|storage|rows|fields|atomic_files)\.py
    | fleet_db/stores/jobs\.py
    | ingest/input_file\.py
    | estimation/(errors|settings|jobs/job|jobs/settings|jobs/scheduler|jobs/catalogue|rules/loading)\.py
    )""",
    re.VERBOSE,
)
VALUES = re.compile(r"estimation/(values/.*|types|ports|storage|alerts|arrays|motion)\.py")
DUNDER = re.compile(r"(.*\.)?__\w+__")


@dataclass(frozen=True)
class Count:
    """One row: what was counted before the house was put in order, now, what is to be reached, and the places."""

    what: str
    before: str
    now: str
    reach: str
    places: tuple[str, ...] = ()


def main(arguments: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser("python -m bench house", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--list", action="store_true", help="print the places of every row, too")
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1], help="another checkout")
    parser.add_argument("--static", action="store_true", help="only what is counted without running the product")
    given = parser.parse_args(arguments)
    console = Console(width=None if Console().is_terminal else 160)
    root = given.root.resolve()
    counts = [*static_counts(root)]
    if not given.static:
        # statements are counted in this process: those of this checkout
        here = root == Path(__file__).resolve().parents[1]
        counts += [*frame_counts(root), *(statement_counts() if here else ()), *start_counts(root)]
    table = Table("what", "before", "now", "reach", title="treadwatch house", title_justify="left")
    for count in counts:
        table.add_row(count.what, count.before, count.now, count.reach)
        if given.list and count.places:
            console.print(f"{count.what}: {count.now}", highlight=False)
            for place in count.places:
                console.print(f"  {place}", highlight=False, soft_wrap=True)
    console.print(table)
    return 0


def figures(root: Path) -> dict[str, int]:
    """Return what docs/architecture.md says that each figure is at most."""
    page = (root / "docs" / "architecture.md").read_text(encoding="utf-8").partition("## Figures")[2]
    return {
        name: int(most.replace(",", ""))
        for name, most in re.findall(r"^\| (\w[^|]*) \| ([\d,]+) \|$", page, re.MULTILINE)
    }


def static_counts(root: Path) -> Iterator[Count]:
    """Yield what is counted from the sources alone."""
    sources = [text for _, text in _sources(root)]
    yield Count("product lines", "119363", str(sum(len(text.splitlines()) for text in sources)), "<= 95000")
    yield Count("modules", "981", str(len(sources)), "<= 640")
    lines = sum(len(text.splitlines()) for _, text in _sources(root, ("bench",)))
    yield Count("bench lines", "18079", str(lines), "<= 12000")
    loose = tuple(sorted(path.name for path in (root / "estimation").glob("*.py") if path.name != "__init__.py"))
    yield Count("modules loose at the top of estimation/", "33", str(len(loose)), "<= 6", loose)
    long = tuple(long_functions(root))
    yield Count(f"functions over {SCREEN} lines", "0", str(len(long)), "0", long)
    hard = tuple(complex_functions(root))
    yield Count(f"functions of complexity over {COMPLEXITY}", "0", str(len(hard)), "0", hard)
    loose_numbers = tuple(map(str, loose_constants(root)))
    yield Count("loose numeric constants of estimation", "902", str(len(loose_numbers)), "<= 85", loose_numbers)
    files = tuple(long_files(root))
    yield Count(f"files over {LONG_FILE} lines", "2", str(len(files)), "0", files)
    words = loose_words(root)
    yield Count(
        "loose words in code and docs",
        "1301",
        str(words.total()),
        "0",
        tuple(f"{word}: {n}" for word, n in words.most_common()),
    )


def _sources(root: Path, folders: Iterable[str] = PACKAGES) -> Iterator[tuple[str, str]]:
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            if MIGRATIONS in path.parts:
                continue
            yield path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")


def _functions(text: str) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return how many lines a function has without its docstring."""
    last = function.end_lineno or function.lineno
    first = function.body[0]
    documented = ast.get_docstring(function, clean=False) is not None
    docstring = (first.end_lineno or first.lineno) - first.lineno + 1 if documented else 0
    return last - function.lineno + 1 - docstring


def long_functions(root: Path) -> Iterator[str]:
    """Yield functions that do not fit a screen."""
    for path, text in _sources(root):
        for function in _functions(text):
            if _lines_of(function) > SCREEN:
                yield f"{path}:{function.lineno} {function.name}: {_lines_of(function)} lines"


def complex_functions(root: Path) -> Iterator[str]:
    """Yield functions that ruff finds too complex, whether a comment allows them or not."""
    options = ["--select", "C901", "--ignore-noqa", "--no-cache", "--isolated", "--output-format", "json"]
    limit = ["--config", f"lint.mccabe.max-complexity={COMPLEXITY}"]
    ruff = Path(sys.executable).parent / "ruff"
    done = subprocess.run(  # noqa: S603 - the linter
        [ruff, "check", *options, *limit, "."], cwd=root, capture_output=True, text=True, check=False
    )
    for item in json.loads(done.stdout):
        path = Path(item["filename"]).relative_to(root).as_posix()
        yield f"{path}:{item['location']['row']} {item['message']}"


def long_files(root: Path) -> Iterator[str]:
    """Yield files that are too long."""
    for path, text in _sources(root, (*PACKAGES, "bench", "tests")):
        lines = len(text.splitlines())
        if lines > LONG_FILE:
            yield f"{path}: {lines} lines"


def loose_words(root: Path) -> Counter[str]:
    """Return how often each loose word stands in code, tests and docs."""
    texts = [text for path, text in _sources(root, (*PACKAGES, "bench", "tests")) if path not in OWN_FILES]
    texts += [path.read_text(encoding="utf-8") for path in (*root.glob("*.md"), *(root / "docs").rglob("*.md"))]
    return Counter(word.lower() for text in texts for word in WORD.findall(text))


def frame_counts(root: Path) -> Iterator[Count]:
    """Yield the files that one frame enters, to the geometry and to all answers."""
    traced = trace(root)
    to_geometry = {stage: files for stage, files in traced.items() if stage in TO_GEOMETRY}
    for name, before, reach, stages in (
        ("its geometry", "175", "<= 79", to_geometry),
        ("geometry, trend and alerts", "216", "<= 104", traced),
    ):
        files = entered_files(stages)
        places = tuple(f"{file}  ({entered})" for file, entered in files.items())
        yield Count(f"files entered by one frame, from log to {name}", before, str(len(files)), reach, places)


def statement_counts() -> Iterator[Count]:
    """Yield the SQL statements from alignment to alerts, and of each job."""
    executed = job_statements()
    places = tuple(f"{job}: {count}" for job, count in executed.items())
    core = sum(executed[job] for job in CORE_JOBS)
    yield Count("SQL statements from alignment to alerts, 6 windows of 2 wheelsets", "890", str(core), "<= 200", places)
    yield Count("SQL statements of any job, the same windows", "370", str(max(executed.values())), "<= 150", places)


def job_statements() -> Mapping[str, int]:
    """Return how many SQL statements each job executes over six windows of two wheelsets."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-house-") as name:
        scenario, folder = load_scenario(str(SCENARIOS / "frame.toml")), Path(name)
        settings = deploy(scenario, folder).model_copy(update={"window_length_s": 120.0})
        receive(record(scenario, folder / "recordings", workers=1), settings)
        stages = Stages()
        with closing(open_store(settings)) as store, store.owned(JobTrigger.CLI, "house", LEASE_S) as storage:
            stages.run_jobs(job_context(settings, storage))
        return stages.statements


def trace(root: Path) -> dict[str, dict[str, list[str]]]:
    """Return by stage and file the functions that run between a recording and the answers."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-house-") as name:
        folder = Path(name)
        environment = environment_of(folder) | {"PYTHONPATH": str(root)}
        simulated = simulate("frame", folder, environment)
        *earlier, last = sorted(simulated.glob("*/*.blf"))
        command(["db", "upgrade"], folder, environment)
        command(["ingest", "--registry", str(simulated / "registry.json"), *map(str, earlier)], folder, environment)
        command(["estimate"], folder, environment)
        script = [sys.executable, "-P", str(Path(__file__).with_name("frame_trace.py")), "T-A2", str(last)]
        done = subprocess.run(script, cwd=folder, env=environment, capture_output=True, text=True, check=False)  # noqa: S603 - our own script
    if done.returncode:
        raise RuntimeError(done.stderr)
    found: dict[str, dict[str, list[str]]] = json.loads(done.stdout)
    return found


def entered_files(traced: dict[str, dict[str, list[str]]]) -> dict[str, str]:
    """Return every counted file and the stages that enter it."""
    entered: dict[str, list[str]] = {}
    for stage, files in traced.items():
        if stage in {ALIGNMENT_JOB, API_START}:
            continue
        for file, functions in files.items():
            values = VALUES.fullmatch(file) or all(DUNDER.fullmatch(name) for name in functions)
            if not values and not INFRASTRUCTURE.fullmatch(file):
                entered.setdefault(file, []).append(stage)
    return {file: ", ".join(stages) for file, stages in sorted(entered.items())}


STARTED = (
    ("--help", "0.12", "0.12"),
    ("serve --help", "2.4", "0.5"),
    ("keys list", "4.4", "0.8"),
    ("recordings list", "3.7", "0.8"),
    ("registry check registry.json", "5.0", "0.8"),
)


def start_counts(root: Path) -> Iterator[Count]:
    """Yield the CPU time that short commands take, on an empty database and the registry of a small fleet."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-house-") as name:
        folder = Path(name)
        # an installation has its bytecode, which the first start writes here
        environment = environment_of(folder) | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": ""}
        simulated = simulate("frame", folder, environment)
        command(["db", "upgrade"], folder, environment)
        for line, before, reach in STARTED:
            words = line.replace("registry.json", str(simulated / "registry.json")).split()
            _, *seconds = (cpu_seconds(words, folder, environment) for _ in range(1 + STARTS))
            yield Count(f"treadwatch {line}, CPU s", before, f"{statistics.median(seconds):.2f}", f"<= {reach}")


def cpu_seconds(words: Sequence[str], folder: Path, environment: dict[str, str]) -> float:
    """Return the CPU seconds, user and system, of one run of the command line."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command(words, folder, environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
