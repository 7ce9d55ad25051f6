"""The one command, ``treadwatch``: every service and every tool is a subcommand of it."""

from __future__ import annotations

import typer


def main() -> None:
    """Run the command line."""
    app = typer.Typer(no_args_is_help=True, add_completion=False)
    app()
