"""``treadwatch reproduce``: the paper's figures 3, 4, 6 and 7, as pictures and as numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from estimation.errors import ParameterError


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for pictures and numbers; made if missing.")] = Path("reproduction"),
    seconds: Annotated[float, typer.Option(min=60.0, help="Length of each run, s of simulated time.")] = 600.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the track.")] = 1,
) -> None:
    """Run the paper's two simulations, estimate all four combinations, draw and write what came out."""
    from api.reproduction import figures, report, study

    console = Console()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"{out}: no folder can be made there: {error.strerror}", field="--out") from error
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        step = progress.add_task("constant gauge: simulate, estimate", total=4)
        constant = study.run(0.0, seconds, seed)
        progress.update(step, advance=1, description="gauge varying by 2 mm: simulate, estimate")
        varying = study.run(study.STANDARD_DEVIATION, seconds, seed)
        progress.update(step, advance=1, description="draw")
        pictures = {
            "figure_3.png": figures.figure_3(constant.table),
            "figure_4.png": figures.figure_4(varying),
            "figure_6.png": figures.figure_estimates(constant, "Fig. 6: estimation, no gauge variation"),
            "figure_7.png": figures.figure_estimates(varying, "Fig. 7: estimation, gauge varying by 2 mm (1 std)"),
        }
        for name, picture in pictures.items():
            picture.savefig(out / name, dpi=110)
        progress.update(step, advance=1, description="write numbers")
        values = report.numbers(constant.table, {"figure_6": constant, "figure_7": varying}, seed)
        (out / "numbers.json").write_text(json.dumps(values, indent=1, allow_nan=False), encoding="utf-8")
        (out / "figure_6.md").write_text(report.page("Figure 6, constant gauge", constant), encoding="utf-8")
        (out / "figure_7.md").write_text(report.page("Figure 7, gauge varying", varying), encoding="utf-8")
        progress.update(step, advance=1, description="done")
    console.print(f"wrote {', '.join([*pictures, 'numbers.json', 'figure_6.md', 'figure_7.md'])} to {out}")
