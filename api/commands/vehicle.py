"""``treadwatch vehicle``: list, show and check vehicle classes, before anybody mounts a sensor."""

from __future__ import annotations

from typing import Annotated

import typer

vehicle = typer.Typer(no_args_is_help=True, help="List, show and check vehicle classes.", rich_markup_mode=None)

_Class = Annotated[str, typer.Argument(metavar="FILE|NAME", help="A TOML file, or the name of a shipped class.")]
_Name = Annotated[str, typer.Argument(metavar="NAME", help="The name of a shipped class.")]
_Speed = Annotated[float, typer.Option(min=1.0, max=150.0, help="m/s.")]
_Conicity = Annotated[float, typer.Option(min=0.005, max=1.0, help="Equivalent conicity of all wheelsets.")]


@vehicle.command("list")
def list_classes() -> None:
    """List the classes that are shipped."""
    from api.terminal.vehicle import class_list

    typer.echo(class_list())


@vehicle.command("show")
def show_class(name: _Name) -> None:
    """Print the file of a shipped class, to copy from."""
    from ingest.vehicle_class_file import shipped_path

    typer.echo(shipped_path(name).read_text(encoding="utf-8"), nl=False)


@vehicle.command("check")
def check_class(file: _Class, speed: _Speed = 20.0, conicity: _Conicity = 0.2) -> None:
    """Print modes, critical speed, and what the sensors see with which std; refuse what no railway vehicle is."""
    from api.terminal.vehicle import check_report, named_class

    typer.echo(check_report(named_class(file), speed, conicity))
