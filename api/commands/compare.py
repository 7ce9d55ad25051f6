"""``treadwatch compare``: how near each estimator comes, on the same stored windows of a simulated fleet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import orjson
import typer
from rich.console import Console

from api.progress import bar
from estimation.errors import ParameterError


def compare(
    scenario: Annotated[str, typer.Option(help="A built-in scenario, or a TOML file.")],
    *,
    seed: Annotated[int, typer.Option(min=0, help="Of the first pair; the next pair has the next seed.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for picture, numbers and simulations; made if missing.")] = Path(
        "comparison"
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON instead of a table.")] = False,
    parameter_errors: Annotated[
        bool, typer.Option("--parameter-errors", help="Let the simulated vehicles differ from the assumed one.")
    ] = False,
) -> None:
    """Simulate a fleet, ingest it, run the jobs and every estimator, and compare them with the truth."""
    from api.comparison import report, study
    from api.plots.compare import save_comparison
    from ingest.simulator.drawn_fleet import with_seed
    from ingest.simulator.scenario import VehicleErrors
    from ingest.simulator.scenario_file import load_scenario

    plan = load_scenario(scenario)
    if parameter_errors:
        plan = replace(plan, vehicle_errors=plan.vehicle_errors or VehicleErrors())
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"{out}: no folder can be made there: {error.strerror}", field="--out") from error
    studies = []
    with bar(Console(stderr=True)) as progress:
        step = progress.add_task("begin", total=1)

        def show(what: str, done: int, of: int) -> None:
            progress.update(step, description=what, completed=done, total=of)

        for number in range(seed, seed + (1 if plan.drawn is None else len(plan.drawn.pairs))):
            found = study.study(with_seed(plan, number), out / "recordings", show)
            studies.append(found)
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
    for sentence in report.sentences_of(studies):
        console.print(sentence, highlight=False, soft_wrap=True)
    console.print(f"wrote comparison.png, comparison.md, comparison.json to {out}", highlight=False, soft_wrap=True)
