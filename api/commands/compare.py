"""``treadwatch compare``: who gets how near, on the same windows of a simulated section."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import orjson
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)

from estimation.errors import ParameterError


def compare(
    scenario: Annotated[str, typer.Option(help="A built-in section scenario by name, or a TOML file.")],
    *,
    seed: Annotated[int, typer.Option(min=0, help="Of the first pair; the next pair has the next seed.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for picture, numbers and simulations; made if missing.")] = Path(
        "comparison"
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON instead of a table.")] = False,
    parameter_errors: Annotated[
        bool, typer.Option("--parameter-errors", help="Let the vehicles differ from what the estimators assume.")
    ] = False,
) -> None:
    """Simulate a section, run every estimator on its windows, print and draw who gets how near."""
    from api.comparison import report, study
    from api.plots.compare import save_comparison
    from ingest.simulator.section_file import load_section_scenario
    from ingest.simulator.section_run import simulate_section

    plan = load_section_scenario(scenario)
    if parameter_errors:
        plan = replace(plan, errors_drawn=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"{out}: no folder can be made there: {error.strerror}", field="--out") from error
    studies = []
    with Progress(*_columns(), console=Console(stderr=True)) as progress:
        step = progress.add_task("begin", total=1)

        def tell(what: str, done: int, of: int) -> None:
            progress.update(step, description=what, completed=done, total=of)

        for number in range(seed, seed + len(plan.pairs)):
            simulated = partial(tell, f"{plan.pair(number).name}: simulate")
            studies.append(study.study(simulate_section(plan, number, out / "simulations", progress=simulated), tell))
    numbers = report.as_json(studies, plan.name)
    text = orjson.dumps(numbers, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()
    (out / "comparison.json").write_text(text, encoding="utf-8")
    (out / "comparison.md").write_text(report.markdown(studies), encoding="utf-8")
    save_comparison(studies, out / "comparison.png")
    if as_json:
        typer.echo(text, nl=False)
        return
    console = Console()
    console.print(report.table(studies))
    for sentence in report.words(studies):
        console.print(sentence, highlight=False, soft_wrap=True)
    console.print(f"wrote comparison.png, comparison.md, comparison.json to {out}", highlight=False, soft_wrap=True)


def _columns() -> tuple[ProgressColumn, ...]:
    return SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
