"""Measured profiles of a registry file: stored about their datum, or refused whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_registry_file import Content, change, load

from estimation.contact.profiles import wheel_profile
from estimation.errors import InputError
from estimation.values.arrays import FloatArray
from fleet_db.storage import SqlStorage
from ingest.registry_file import read_registry

WHEEL = wheel_profile("P8")
WHOLE = np.arange(-68.0, 60.0, 0.25)  # mm


def rows(y: FloatArray, worn: float = 0.0, shift: float = 0.0) -> str:
    """Return P8 at lateral positions y as two columns, its tread hollow by ``worn``, its datum at ``shift``; mm."""
    z = WHEEL.height(y * 1e-3) * 1e3 - worn * np.exp(-((y / 20.0) ** 2))
    return "y z\n" + "".join(f"{a:.3f} {b:.6f}\n" for a, b in zip(y + shift, z, strict=True))


@pytest.fixture
def measured(registry: Path) -> Path:
    """Return a registry with a measurement of the wheels of A."""
    (registry.parent / "left.txt").write_text(rows(WHOLE))
    (registry.parent / "right.txt").write_text(rows(WHOLE, 0.5))
    entry = {
        "wheelset": "A",
        "at": "2024-12-31T00:00:00Z",
        "mileage_km": 152000.5,
        "left": {"file": "left.txt"},
        "right": {"file": "right.txt"},
    }
    change(registry, lambda content: content.update(measured_profiles=[entry]))
    return registry


def test_measured_profiles_land_in_the_store(storage: SqlStorage, measured: Path) -> None:
    for std_mm, wanted in ((None, 0.1e-3), (0.25, 0.25e-3)):
        if std_mm is not None:
            change(measured, lambda c, std_mm=std_mm: c["measured_profiles"][0].update(std_mm=std_mm))
        load(storage, measured)
        with storage.read() as unit:
            (found,) = unit.registry.measured_profiles("A")
            assert unit.registry.measured_profiles("B") == []
        assert (found.wheelset, found.mileage_km, found.std) == ("A", 152000.5, pytest.approx(wanted))
        assert found.at_ns == 1_735_603_200_000_000_000
        assert [(one.kind, one.name) for one in (found.left, found.right)] == [("wheel", "left"), ("wheel", "right")]
        y = np.linspace(-0.05, 0.05, 101)
        np.testing.assert_allclose(found.left.height(y), WHEEL.height(y), atol=1e-6)
        worn = 0.5e-3 * (1.0 - np.exp(-((y / 20e-3) ** 2)))  # the datum is the tread as it is
        np.testing.assert_allclose(found.right.height(y), WHEEL.height(y) + worn, atol=1e-6)


def test_a_wheelset_that_is_stored_already_may_be_measured(sqlite_storage: SqlStorage, measured: Path) -> None:
    load(sqlite_storage, measured)
    content = json.loads(measured.read_text())
    kept = {"format": content["format"], "measured_profiles": content["measured_profiles"]}
    kept["measured_profiles"][0]["at"] = "2025-01-01T00:00:00Z"
    measured.write_text(json.dumps(kept))
    load(sqlite_storage, measured)
    with sqlite_storage.read() as unit:
        assert len(unit.registry.measured_profiles("A")) == 2


def one(content: Content) -> Content:
    """Return the one measurement."""
    found: Content = content["measured_profiles"][0]
    return found


BAD_MEASUREMENTS: list[tuple[Callable[[Content], object], str, str]] = [
    (lambda c: one(c).update(wheelset="Z"), "", "no wheelset 'Z'"),
    (lambda c: one(c).update(std_mm=-0.1), ".std_mm", "greater than 0"),
    (lambda c: one(c).update(std_mm=0), ".std_mm", "greater than 0"),
    (lambda c: one(c).update(std_mm=None), ".std_mm", "number"),
    (lambda c: one(c).update(mileage_km=-1), ".mileage_km", "at least 0"),
    (lambda c: one(c).update(at="2024-12-31"), ".at", "offset"),
    (lambda c: one(c).update(note="turned"), ".note", "unknown"),
    (lambda c: one(c).pop("right"), ".right", "missing"),
    (lambda c: one(c).update(right="right.txt"), ".right", "not an object"),
    (lambda c: one(c)["left"].update(unit="m"), ".left.unit", "unknown"),
    (lambda c: one(c)["left"].update(file="none.whl"), ".left.file", "none.whl: cannot be read"),
]


@pytest.mark.parametrize(("edit", "place", "words"), BAD_MEASUREMENTS)
def test_a_bad_measurement_is_named_and_nothing_is_stored(
    sqlite_storage: SqlStorage, measured: Path, edit: Callable[[Content], object], place: str, words: str
) -> None:
    change(measured, edit)
    with pytest.raises(InputError) as refused:
        load(sqlite_storage, measured)
    assert (refused.value.file, refused.value.field) == (str(measured), f"measured_profiles[0]{place}")
    assert words in str(refused.value)
    with sqlite_storage.read() as unit:
        assert not unit.registry.fleets()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n3 x\n", "right.txt:2, field 'z': 'x' is not a number"),
        ("", "0 profile points"),
        (
            rows(WHOLE[WHOLE < 20.0]),
            "reaches from -68.0 to +19.8 mm from the tread datum; flange and tread from -45 to +30 mm",
        ),
        (rows(WHOLE[WHOLE > -40.0]), "no flange: its tip is expected between -70 and -45 mm from the tread datum"),
        ("".join(f"{y:.2f} {-y / 20.0:.4f}\n" for y in WHOLE), "no flange"),
        (rows(WHOLE, shift=-20.0), "no flange"),
    ],
)
def test_a_profile_that_is_no_whole_wheel_is_refused(measured: Path, text: str, words: str) -> None:
    (measured.parent / "right.txt").write_text(text)
    with pytest.raises(InputError) as refused:
        read_registry(measured)
    assert (refused.value.file, refused.value.field) == (str(measured), "measured_profiles[0].right.file")
    assert words in str(refused.value)
