"""``treadwatch demo``: the main job, end to end, on the embedded default."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    *,
    once: Annotated[bool, typer.Option("--once", help="End after the table instead of serving on.")] = False,
    scenario: Annotated[str, typer.Option(help="Name of a built-in scenario, or a TOML file.")] = "demo",
    folder: Annotated[Path, typer.Option(help="Where the demo keeps its files; emptied at each start.")] = Path(
        "treadwatch-data/demo"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the API; another if it is taken.")] = 8000,
) -> None:
    """Simulate a fleet on CAN, receive it, estimate it, and serve trends and alerts."""
    from api.terminal.demo import run_demo

    run_demo(scenario, folder, port, keep_serving=not once)
