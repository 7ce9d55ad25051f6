"""``treadwatch settings`` and the help name every environment variable and its default, and show no value."""

from __future__ import annotations

import inspect
import re
from importlib import import_module

import click
import pytest
import typer
from in_process_command import Run

from api.cli import COMMANDS
from api.settings import Settings
from api.terminal.settings import default_of, described, variable_of

OWN = {("demo", "port"), ("rules replay", "rules_file"), ("simulate", "workers")}
"""Options that have a setting's name and are not read from it."""


def _options(command: click.Command, name: str) -> list[tuple[str, click.Parameter]]:
    if isinstance(command, click.Group):
        return [found for key, one in command.commands.items() for found in _options(one, f"{name} {key}")]
    return [(name, parameter) for parameter in command.params]


def _all_options() -> list[tuple[str, click.Parameter]]:
    found = []
    for command in COMMANDS:
        target = getattr(import_module(f"api.commands.{command.module}"), command.name)
        if not isinstance(target, typer.Typer):
            function, target = target, typer.Typer(add_completion=False)
            target.command()(function)
        found += _options(typer.main.get_command(target), command.name)
    return found


def test_every_setting_is_listed_with_its_default_and_meaning(treadwatch: Run) -> None:
    printed = treadwatch("settings").stdout
    for name in Settings.model_fields:
        assert re.search(rf"^{variable_of(name)} +{re.escape(default_of(name))}( |$)", printed, re.MULTILINE), name
    documented = [name for names, _ in described(inspect.getdoc(Settings) or "") for name in names]
    assert set(documented) == set(Settings.model_fields)
    assert all(len(line) <= 100 for line in printed.splitlines())


def test_a_value_that_is_set_is_marked_and_never_shown(treadwatch: Run) -> None:
    printed = treadwatch("settings", database_password="se/cr@t", port="").stdout  # noqa: S106 - of no server
    assert re.search(r"^TREADWATCH_DATABASE_PASSWORD +none  \(in the environment\)$", printed, re.MULTILINE)
    assert re.search(r"^TREADWATCH_PORT +8000$", printed, re.MULTILINE)
    assert "se/cr@t" not in printed


def test_an_option_of_a_setting_names_its_variable_and_default() -> None:
    seen = 0
    for name, option in _all_options():
        if option.name in Settings.model_fields and (name, option.name) not in OWN:
            assert option.name is not None
            wanted = f"[env var: {variable_of(option.name)}; default: {default_of(option.name)}]"
            assert wanted in (getattr(option, "help", None) or ""), name
            seen += 1
    assert seen >= 2


@pytest.mark.parametrize("command", [one.name for one in COMMANDS])
def test_help_says_where_the_settings_are_listed(treadwatch: Run, command: str) -> None:
    reads = next(one.reads_settings for one in COMMANDS if one.name == command)
    assert ("'treadwatch settings'" in " ".join(treadwatch(command, "-h").stdout.split())) is reads
