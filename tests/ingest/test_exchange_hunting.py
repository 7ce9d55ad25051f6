"""Hunting in an exchange: found in its windows as in those of a bus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from exchange_runs import register, true_run
from test_exchange import Received, example

from estimation.motion.hunting import hunting_reason
from estimation.values.reasons import ReasonCode, code_of
from fleet_db.storage import SqlStorage

FREQUENCY_HZ, AMPLITUDE = 2.5, 6e-3  # of what the first axle does beside following the track


def test_a_wheelset_that_hunts_is_found_and_its_neighbour_is_not(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    columns = dict(true_run(tmp_path))
    omega, t = 2.0 * np.pi * FREQUENCY_HZ, columns["t"]
    columns["ay_1"] = columns["ay_1"] - omega**2 * AMPLITUDE * np.sin(omega * t)
    columns["yaw_1"] = columns["yaw_1"] - omega**3 * AMPLITUDE / columns["v"] * np.cos(omega * t)  # V psi = y'
    place = Received(sqlite_storage, tmp_path)
    place.receiver.receive_exchange(example(tmp_path, columns))
    windows = place.windows().values()
    hunting, other = ([one.quality for one in windows if one.axle == axle] for axle in (1, 2))
    assert len(hunting) == len(other) == 3
    for quality in hunting:
        assert code_of(hunting_reason(quality)) is ReasonCode.HUNTING
        assert quality.hunting.share == 1.0
        assert quality.hunting.frequency_hz == pytest.approx(FREQUENCY_HZ, rel=0.02)
        assert quality.hunting.amplitude == pytest.approx(AMPLITUDE, rel=0.1)
    assert [quality.hunting.share for quality in other] == [0.0, 0.0, 0.0]
