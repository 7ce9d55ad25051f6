"""What is stored of lateral dampers, on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import stored_values as make
from same_values import same_values

from estimation.errors import StorageError
from estimation.jobs.stage import made_from
from estimation.values.opinions import GEAR_DAMPERS, DamperSums, GearDamper, WindowDamper, part_of_gear
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Result
from estimation.values.sums import SHARES
from fleet_db.packed_values import pack_value, unpack_window_damper
from fleet_db.storage import SqlStorage, SqlUnitOfWork


def stored_window(storage: SqlStorage, index: int = 0, seed: int = 0) -> tuple[int, str]:
    window = make.window(index, seed=seed)
    with storage.write() as unit:
        unit.windows.put(window, 100.0, make.START)
        record = unit.windows.get("WS-1", window.start_ns)
    assert record is not None
    return record.start_ns, record.content_digest


def made(start_ns: int, digest: str, reason: Reason | None = None) -> WindowDamper:
    half = np.random.default_rng(start_ns % 1000).standard_normal((len(SHARES) - 1, 5, 5))
    sums = None if reason else DamperSums(half + half.transpose(0, 2, 1), 525.25, 1)
    return WindowDamper("V-1", 1, "WS-1", start_ns, 1234.5, digest, "c" * 64, 0.025, 0.01, sums, reason)


def test_what_windows_say_comes_back_bit_for_bit_newest_first(fleet: SqlStorage) -> None:
    refused = Reason(ReasonCode.DAMPER_NOT_EXCITED, "too little")
    found = [made(*stored_window(fleet, 0)), made(*stored_window(fleet, 1), refused)]
    with fleet.write() as unit:
        for one in found:
            unit.dampers.put_all([one])
            unit.dampers.put_all([one])
    with fleet.read() as unit:
        newest = unit.dampers.newest("V-1", 1, 10)
        assert [one.start_ns for one in unit.dampers.newest("V-1", 1, 1)] == [found[1].start_ns]
        assert unit.dampers.newest("V-1", 3, 10) == []
    assert newest[0] == found[1]
    assert newest[1].sums is not None
    assert found[0].sums is not None
    assert same_values(newest[1].sums, found[0].sums)
    assert replace(newest[1], sums=None) == replace(found[0], sums=None)


def test_windows_with_other_samples_say_nothing(fleet: SqlStorage) -> None:
    start_ns, digest = stored_window(fleet)
    with fleet.write() as unit:
        unit.dampers.put_all([made(start_ns, digest)])
        assert len(unit.dampers.newest("V-1", 1, 10)) == 1
        unit.dampers.put_all([made(start_ns, "0" * 64)])
        assert unit.dampers.newest("V-1", 1, 10) == []


def test_old_windows_are_forgotten(fleet: SqlStorage) -> None:
    keys = [stored_window(fleet, index) for index in range(3)]
    with fleet.write() as unit:
        for key in keys:
            unit.dampers.put_all([made(*key)])
        assert unit.dampers.forget("V-1", 1, keys[2][0]) == 2
        assert [one.start_ns for one in unit.dampers.newest("V-1", 1, 10)] == [keys[2][0]]


def gear(share: Estimate) -> GearDamper:
    known = share.value is not None
    return GearDamper("V-1", 1, share, 0.97 if known else None, True if known else None, 7, 1, 2, 5, 9, 1.5, 2.5)


def put(unit: SqlUnitOfWork, found: GearDamper) -> None:
    unit.results.put_all(GEAR_DAMPERS, [Result("V-1", made_from(found), "1", 1, found, part_of_gear(1))])


def test_the_damper_of_a_running_gear_is_replaced_and_comes_back(fleet: SqlStorage) -> None:
    unknown = gear(Estimate.unknown(Reason(ReasonCode.TOO_FEW_WINDOWS, "few"), 2.0))
    known = gear(with_interval(0.3, 0.02, 0.01, 7, 7.0))
    with fleet.write() as unit:
        for one in (unknown, known):
            put(unit, one)
            assert unit.dampers.of_vehicles(["V-1"]) == [one]
        assert unit.dampers.of_vehicles(["V-2"]) == []


def test_a_blob_of_another_kind_is_damage() -> None:
    blob = pack_value(gear(Estimate.unknown(Reason(ReasonCode.TOO_FEW_WINDOWS, "few"))))
    with pytest.raises(StorageError):
        unpack_window_damper(blob, where="here")
