"""The windows of a span are stored together: with as many statements however many they are, and nothing lost."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy
from executed_statements import executed_statements
from test_receiver import CountingClock, content, files_of
from vehicle_bus import SECOND_NS, START_NS, VEHICLE, Run
from waiting_windows import waiting_windows

from estimation.values.windows import WindowPosition, WindowState
from fleet_db.raw import FileRawStore
from fleet_db.storage import SqlStorage
from fleet_db.stores.assembled import AssembledWindowStore, StoredWindow
from ingest.catalogue import default_catalogue
from ingest.frames import take
from ingest.receiver import Receiver
from ingest.vehicle_class_schema import shipped_class


def receiver_on(storage: SqlStorage, directory: Path) -> Receiver:
    return Receiver(
        storage, FileRawStore(directory / "raw"), default_catalogue(), CountingClock(), window_length_s=10.0
    )


def test_a_recording_takes_as_many_statements_however_many_windows_it_has(
    registered: SqlStorage, tmp_path: Path
) -> None:
    runs = [Run(seconds=seconds, start_ns=START_NS + at * SECOND_NS) for at, seconds in ((0, 9.0), (600, 90.0))]
    paths = files_of([run.frames() for run in runs], tmp_path)
    receiver, counts, windows = receiver_on(registered, tmp_path), [], []
    for path in paths:
        with executed_statements() as asked:
            windows.append(receiver.receive_file(path, VEHICLE).windows_changed)
        counts.append(len(asked))
    assert windows[1] >= 5 * windows[0] > 0
    assert counts[1] <= counts[0], counts


def test_more_frames_of_windows_without_bin_tables_replace_them_in_one_statement(
    registered: SqlStorage, tmp_path: Path
) -> None:
    run = Run(seconds=20.0).frames()  # three windows, the middle one whole
    late = (run.t_ns >= run.t_ns[0] + 8 * SECOND_NS) & (run.t_ns < run.t_ns[0] + 9 * SECOND_NS)
    paths = files_of([take(run, ~late), take(run, late)], tmp_path)
    receiver = receiver_on(registered, tmp_path)
    receiver.receive_file(paths[0], VEHICLE)
    with registered.write() as unit:
        unit.registry.add_vehicle_class(replace(shipped_class("coach"), code="multiple unit"), 1)
        before = content(unit)
        for key in before:
            unit.windows.mark(*key, WindowState.ESTIMATED)
            unit.tracks.put_positions([WindowPosition(*key, before[key][0], 1)])
    with executed_statements() as asked:
        assert receiver.receive_file(paths[1], VEHICLE).windows_changed == 2
    assert sum(statement.startswith("UPDATE windows") for statement in asked) == 1
    changed = {("WS-1", START_NS + 7 * SECOND_NS), ("WS-2", START_NS + 7 * SECOND_NS)}
    with registered.read() as unit:
        after = content(unit)
        assert {key for key in after if after[key] != before[key]} == changed
        assert {(r.wheelset, r.start_ns) for r in waiting_windows(unit)} == changed
        assert {key for key in before if unit.tracks.position(*key) is None} == changed, "their partners are others too"


def test_windows_that_another_transaction_has_stored_meanwhile_are_looked_at_one_by_one(
    registered: SqlStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(seconds=20.0).frames()
    middle = len(run) // 2
    paths = files_of([take(run, slice(None, middle)), take(run, slice(middle, None)), run], tmp_path)
    whole = receiver_on(registered, tmp_path)
    whole.receive_file(paths[2], VEHICLE)
    with registered.write() as unit:
        wanted = content(unit)
        for serial in ("WS-1", "WS-2"):
            unit.assembled.remove(unit.windows.list(serial))
        unit.connection.execute(sqlalchemy.text("DELETE FROM chunks"))
    receiver = receiver_on(registered, tmp_path)
    receiver.receive_file(paths[0], VEHICLE)

    def before_the_other(
        _store: AssembledWindowStore, _vehicle: str, _wheelsets: Collection[str], _from: int, _to: int
    ) -> Sequence[StoredWindow]:
        return ()

    monkeypatch.setattr(AssembledWindowStore, "in_span", before_the_other)
    receiver.receive_file(paths[1], VEHICLE)
    with registered.read() as unit:
        assert content(unit) == wanted
