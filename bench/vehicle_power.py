"""Parameters that are wrong on file by more and more: the scenarios behind the power curve of the tests of fit.

The soft bogies of ``soft_known`` run as they are; the class on file differs from them in one parameter. Names of rows
are ``power:<parameter>:<error in percent>``; an error of 0 gives the false alarms.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ingest.simulator.scenario import ClassOnFile, Scenario
from ingest.vehicle_class_schema import read_vehicle_class

PREFIX = "power"
BASE = "soft_known"  # scenario
CLASS_FILE = Path(__file__).parent / "vehicle_scenarios" / "classes" / "soft.toml"
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class WrongParameter:
    """A parameter of the class file, and by how much it is wrong."""

    key: str  # in the file, where it stands first
    percent: tuple[int, ...]


STIFFNESS_PERCENT = (-50, -20, -10, 10, 20, 50, 100)
PARAMETERS: Mapping[str, WrongParameter] = {
    "yaw_stiffness": WrongParameter("yaw_stiffness_n_m_rad", STIFFNESS_PERCENT),
    "lateral_stiffness": WrongParameter("lateral_stiffness_n_m", STIFFNESS_PERCENT),
    "wheelbase": WrongParameter("wheelbase_m", (-30, -20, -10, 10, 20, 30)),
    "nominal_radius": WrongParameter("nominal_radius_mm", (-10, -5, -2, 2, 5, 10)),
    "mass": WrongParameter("mass_kg", (-20, -10, 10, 20)),
}
ROWS: tuple[str, ...] = (
    f"{PREFIX}:{NOTHING}:0",
    *(f"{PREFIX}:{name}:{percent:+d}" for name, wrong in PARAMETERS.items() for percent in wrong.percent),
)


def parts(row: str) -> tuple[str, int]:
    """Return parameter and error in percent of a row's name."""
    _, name, percent = row.split(":")
    return name, int(percent)


def with_wrong_parameter(scenario: Scenario, row: str, folder: Path) -> Scenario:
    """Return a scenario whose class on file is wrong as the row's name says.

    Args:
        scenario: That of ``BASE``, with its seed.
        row: One of ``ROWS``.
        folder: Where the class file is written; exists.
    """
    name, percent = parts(row)
    text = CLASS_FILE.read_text(encoding="utf-8")
    if name != NOTHING:
        text = scaled(text, PARAMETERS[name].key, 1.0 + percent / 100.0)
    path = folder / CLASS_FILE.name
    path.write_text(text, encoding="utf-8")
    on_file = read_vehicle_class(path)
    radius = on_file.parameters.nominal_radius if name == "nominal_radius" else None
    return replace(scenario, name=row, class_on_file=ClassOnFile(path, on_file, radius))


def scaled(text: str, key: str, factor: float) -> str:
    """Return a class file with the first value of ``key`` multiplied by ``factor``.

    Args:
        factor: What it is multiplied by.
    """
    found = re.search(rf"^{key} = (\S+)$", text, flags=re.MULTILINE)
    assert found is not None, key
    begin, end = found.span(1)
    return f"{text[:begin]}{factor * float(found[1]):g}{text[end:]}"
