"""Alert rules of a demo's fleet: the limit of a maintenance plan, which the shipped rules leave to the operator."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from api.settings import Settings

FILE = "rules.toml"


def with_rules(settings: Settings, name: str, folder: Path) -> Settings:
    """Return settings with the rules of a scenario, where it has some and the deployment does not name others.

    Args:
        folder: Of the demo; the rules are put there, to be read and changed.
    """
    shipped = files("api.demo").joinpath("rules", f"{name}.toml")
    if settings.rules_file is not None or not shipped.is_file():
        return settings
    file = folder / FILE
    file.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    return settings.model_copy(update={"rules_file": file})
