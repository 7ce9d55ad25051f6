"""The settings of a deployment as the terminal shows them: variable, default, meaning."""

from __future__ import annotations

import inspect
import os
import re
import textwrap
from collections.abc import Iterator, Sequence

import typer

from api.settings import PREFIX, Settings

WIDTH = 80
NAME_WIDTH = 41
NOTHING = "none"


def print_settings() -> None:
    """Print every setting, those with one meaning together, and which are in the environment; never a value."""
    typer.echo("From the environment, or from .env in the working directory; an empty value means not set.\n")
    for names, meaning in described(inspect.getdoc(Settings) or ""):
        for name in names:
            variable = variable_of(name)
            there = "  (in the environment)" if os.environ.get(variable) else ""
            typer.echo(f"{variable:{NAME_WIDTH}} {default_of(name)}{there}")
        typer.echo(textwrap.fill(meaning, WIDTH, initial_indent="    ", subsequent_indent="    ") + "\n")


def variable_of(name: str) -> str:
    """Return the environment variable of a setting."""
    return f"{PREFIX}{name.upper()}"


def default_of(name: str) -> str:
    """Return what holds where a setting is left out, as it would be written."""
    default = Settings.model_fields[name].default
    return NOTHING if default is None else str(default)


def described(documentation: str) -> Iterator[tuple[Sequence[str], str]]:
    """Yield the names of settings and what they mean, as the class documents its parameters."""
    _, _, parameters = documentation.partition("Args:\n")
    for names, meaning in re.findall(r"^    (\S[^:]*): (.*\n?(?:        .*\n?)*)", parameters, re.MULTILINE):
        yield names.split(", "), " ".join(meaning.split()).replace("``", "")
