"""The bench of the rivals: its fleets are what they are called, and its rows count what they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.rivals import JUMPS, SMOOTH, bench_rows, fleet, floor, near_rows, parts, table_rows
from estimation.contact.geometry import refined_curve
from ingest.simulator.axle_motion import contact_of
from ingest.simulator.campaign import scenario_track


@pytest.mark.parametrize(("family", "jumps"), [(SMOOTH, 0), (JUMPS, 2)])
def test_smooth_wheels_have_no_contact_jump_and_the_others_do(family: str, jumps: int, tmp_path: Path) -> None:
    scenario = fleet(family, 3, 1, tmp_path)
    plans = [plan for vehicle in scenario.vehicles for plan in vehicle.wheelsets]
    assert len(plans) == 4
    track, slopes = scenario_track(scenario), []
    for plan in plans[1:]:
        contact = contact_of(scenario, track, plan, 100e3)
        curve = refined_curve(contact.wheelset, contact.table, 0)
        assert (np.abs(curve.jumps) < 2.5e-3).sum() == jumps
        slopes.append(np.interp(3e-3, curve.displacement, curve.difference))
    assert np.diff(slopes).min() > 0.05e-3, "wheelsets differ"


def scored(estimator: str, errors: list[float | None], as_run: list[float | None], **other: Any) -> dict[str, Any]:  # noqa: ANN401
    given = [error for error in errors if error is not None]
    compared = [None if error is None else [error, 0.1, True] for error in errors]
    base: dict[str, Any] = {
        "family": JUMPS, "seed": 0, "track": "known", "estimator": estimator, "serial": "W00", "errors": errors,
        "compared": compared, "errors_as_run": as_run, "own_covered": [False] * len(given), "reason": "",
        "cpu_s": 2.0, "running_s": 1800.0, "state_bytes": 4000,
    }  # fmt: skip
    return base | other


def test_rows_are_of_what_was_estimated() -> None:
    nothing: list[float | None] = [None] * 4
    found = [
        scored("bins", [0.03, -0.02, 0.0, 0.0], [0.01, -0.01, 0.0, 0.0]),
        scored("hidden", [0.012, -0.008, 0.0, 0.5], [0.002, 0.002, 0.0, 0.5], cpu_s=3.0),
        scored("extended_kalman", nothing, nothing, reason="diverged"),
    ]
    rows = {row[2]: row for row in table_rows(found)}
    assert rows["extended_kalman"][3] == "0 of 1 (diverged)"
    assert rows["bins"][3:8] == ("1 of 1", "0.0100", "0.0285", "0 % of 4", "900")
    assert rows["hidden"][7:] == ("600", "4")
    near = {row[1]: row for row in near_rows(found)}
    assert near["hidden"][4:] == ("0.0020", "0.0020")
    assert floor(found) == pytest.approx(np.quantile([0.02, 0.01, 0.0], 0.95))
    met = {row.what: row.met for row in bench_rows(found)}
    assert [met[what] for what in met if what.startswith("hidden, next")] == [False, True]
    assert [met[what] for what in met if what.startswith("bins, next")] == [False, True]
    assert [met[what] for what in met if what.startswith("hidden: real-time")] == [False]
    assert str(parts(found)[0]).startswith("Seeds: P8/113A: 0.")
