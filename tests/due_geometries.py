"""Which wheelsets the stage of geometries is to look at, for tests of what makes it do so."""

from __future__ import annotations

from estimation.jobs.refresh_geometry import GEOMETRY
from estimation.storage import UnitOfWork
from estimation.values.runs import Mark, StageInputs

INPUTS = StageInputs(GEOMETRY.name, GEOMETRY.kind, GEOMETRY.facets, "")


def due_geometries(unit: UnitOfWork, inputs: StageInputs = INPUTS) -> list[str]:
    """Return the wheelsets that are others than at the last :func:`see_geometries`, and have something to estimate."""
    due = list(unit.marks.due(inputs, 0))
    estimable = unit.geometries.estimable(due)
    return [serial for serial in due if serial in estimable]


def see_geometries(unit: UnitOfWork) -> None:
    """Let all wheelsets be seen as they are."""
    unit.marks.note(INPUTS, {serial: Mark(state.seen, "") for serial, state in unit.marks.due(INPUTS, 0).items()})
