"""What is stored of wear signatures and answers, on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import stored_values as make
from same_values import same_values
from sqlalchemy import update

from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Mark, Result, StageInputs, SubjectKind
from estimation.values.signatures import (
    ANSWERS,
    SIGNATURES,
    AxlePosition,
    Basis,
    ConicitySource,
    Disagreement,
    Place,
    Signature,
    SignatureAnswer,
    SignatureFinding,
    StateProbability,
    UsedEntry,
    WindowSignatures,
)
from estimation.values.windows import WindowKey, WindowState, key_of_text
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores import signatures as signature_store
from fleet_db.tables.windows import WearSignatureRow

OF_WINDOWS = StageInputs(SIGNATURES, SubjectKind.WINDOW, (), "")


def signature(start_ns: int, order: int, place: Place | None) -> Signature:
    spectra = np.random.default_rng(order).standard_normal((8, 9))
    return Signature("WS-1", "V-1", "C", AxlePosition.LEADING, start_ns, order, place, 17.25, spectra, 11.5)


def stored_window(storage: SqlStorage, index: int = 0, seed: int = 0) -> tuple[int, str]:
    window = make.window(index, seed=seed)
    with storage.write() as unit:
        unit.windows.put(window, 100.0, make.START)
        record = unit.windows.get("WS-1", window.start_ns)
    assert record is not None
    return record.start_ns, record.content_digest


def made(start_ns: int, digest: str, reason: Reason | None = None, *, placed: bool = True) -> WindowSignatures:
    signatures = tuple(signature(start_ns, k, Place("S-7", 4 + k) if placed else None) for k in range(3))
    return WindowSignatures("WS-1", start_ns, "V-1", digest, "a" * 64, () if reason else signatures, reason)


def test_signatures_come_back_bit_for_bit_with_the_mileage_of_their_window(fleet: SqlStorage) -> None:
    for placed in (True, False):
        found = made(*stored_window(fleet), placed=placed)
        with fleet.write() as unit:
            unit.signatures.put_all([found])
        with fleet.read() as unit:
            (known,) = unit.signatures.known().known
        assert replace(known.found, signatures=()) == replace(found, signatures=())
        assert len(known.found.signatures) == len(found.signatures)
        for back, one in zip(known.found.signatures, found.signatures, strict=True):
            assert same_values(back, one)
        assert known.mileage_km == 100.0


def due(unit: SqlUnitOfWork) -> list[WindowKey]:
    """Return the windows whose signatures are to be made."""
    return [key_of_text(key) for key in unit.due.due(OF_WINDOWS)]


def remove_due(unit: SqlUnitOfWork) -> None:
    unit.due.note(OF_WINDOWS, {key: Mark(one.seen, "") for key, one in unit.due.due(OF_WINDOWS).items()})


def test_a_window_is_due_with_its_samples_and_again_with_others(fleet: SqlStorage) -> None:
    start_ns, digest = stored_window(fleet)
    with fleet.write() as unit:
        assert due(unit) == [("WS-1", start_ns)]
        unit.signatures.put_all([made(start_ns, digest)])
        remove_due(unit)
        assert due(unit) == []
    stored_window(fleet, seed=5)
    with fleet.read() as unit:
        assert due(unit) == [("WS-1", start_ns)]
        assert unit.signatures.known().known == [], "those of other samples are not known"


def test_a_damaged_row_is_named_beside_what_is_known_and_made_again_once_it_is_dropped(fleet: SqlStorage) -> None:
    keys = [stored_window(fleet, index) for index in range(2)]
    with fleet.write() as unit:
        unit.signatures.put_all([made(*key) for key in keys])
        table = table_of(WearSignatureRow)
        unit.connection.execute(update(table).where(table.c.start_ns == keys[0][0]).values(packed=b"torn"))
    with fleet.write() as unit:
        stored = unit.signatures.known()
        assert [one.found.start_ns for one in stored.known] == [keys[1][0]]
        ((wheelset, start_ns, text),) = stored.damaged
        assert (wheelset, start_ns) == ("WS-1", keys[0][0])
        assert "signatures of WS-1@" in text
        remove_due(unit)
        unit.signatures.drop([(wheelset, start_ns)])
        assert due(unit) == [(wheelset, start_ns)]


def test_a_refusal_is_kept_and_one_for_want_of_the_other_axle_is_tried_again(fleet: SqlStorage) -> None:
    start_ns, digest = stored_window(fleet)
    short = Reason(ReasonCode.PASS_TOO_SHORT, "too short")
    frame = Reason(ReasonCode.FRAME_UNKNOWN, "no other axle")
    for reason, again in ((short, []), (frame, [("WS-1", start_ns)])):
        with fleet.write() as unit:
            unit.signatures.put_all([made(start_ns, digest, reason)])
            remove_due(unit)
            unit.windows.mark("WS-1", start_ns, WindowState.PENDING)
            assert due(unit) == []
            unit.windows.mark("WS-1", start_ns, WindowState.ESTIMATED)
            assert due(unit) == again


def test_signatures_of_other_assumptions_are_due(fleet: SqlStorage) -> None:
    start_ns, digest = stored_window(fleet)
    with fleet.write() as unit:
        unit.signatures.put_all([made(start_ns, digest)])
        remove_due(unit)
        assert unit.signatures.vehicles(["WS-1", "WS-2"]) == [("WS-1", "V-1")]
        unit.signatures.list_other([("WS-1", "V-1", "a" * 64)])
        assert due(unit) == []
        unit.signatures.list_other([("WS-1", "V-1", "b" * 64)])
        assert due(unit) == [("WS-1", start_ns)]


FINDING = SignatureFinding(
    answer=SignatureAnswer(
        "WS-1",
        Estimate(0.21, 0.01, 0.19, 0.23, 12.0, Status.ESTIMATED),
        Basis.SAME_PLACES,
        (StateProbability(0.0, 0.2, 0.25), StateProbability(0.2, float("inf"), 0.75)),
        (UsedEntry("WS-2", "S-7", 0.2, 0.5, ConicitySource.MEASURED_PROFILES),),
        9,
        2,
        0.25,
    ),
    baseline=1,
    signatures=12,
    from_ns=5,
    to_ns=9,
    left_out={"same_wheelset": 3},
    geometry=Estimate(0.25, 0.005, 0.24, 0.26, 4.0, Status.ESTIMATED),
    disagreement=Disagreement(-0.04, 0.011, disagrees=True, reason=Reason(ReasonCode.METHODS_DISAGREE, "apart")),
)


def test_the_newest_answer_takes_the_place_of_the_one_before(fleet: SqlStorage) -> None:
    silent = replace(
        FINDING,
        answer=SignatureAnswer("WS-1", Estimate.unknown(Reason(ReasonCode.LIBRARY_TOO_SMALL, "too few"))),
        geometry=None,
        disagreement=None,
    )
    for digest, one in (("d" * 64, FINDING), ("e" * 64, silent)):
        with fleet.write() as unit:
            unit.results.put_all(ANSWERS, [Result("WS-1", digest, "9", 77, one)])
        with fleet.read() as unit:
            result = unit.results.latest(ANSWERS, "WS-1")
            assert result is not None
            assert result.value == one
            assert unit.results.made_from(ANSWERS) == {"WS-1": (digest, "9")}


def test_of_a_wheelset_section_and_band_of_speed_the_newest_windows_are_known(
    fleet: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert signature_store.NEWEST == 24
    monkeypatch.setattr(signature_store, "NEWEST", 2)
    keys = [stored_window(fleet, index) for index in range(4)]
    with fleet.write() as unit:
        unit.signatures.put_all([made(*keys[0], placed=False), *(made(*key) for key in keys[1:])])
        assert [one.found.start_ns for one in unit.signatures.known().known] == [key[0] for key in (keys[0], *keys[2:])]
