"""Windows in files: the same bits back, one name for one content, damage named."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import stored_values as make
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from same_values import same_values

from estimation.errors import StorageError
from estimation.values.windows import ACCELERATIONS, Window, WindowQuality
from fleet_db.telemetry import WindowFiles, pack_window, unpack_window, window_digest

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def windows(draw: st.DrawFn) -> Window:
    n = draw(st.integers(0, 30))
    resolution = tuple(draw(st.floats(1e-9, 10.0)) for _ in range(4))
    valid = draw(hnp.arrays(np.bool_, n))
    counts = [draw(hnp.arrays(np.int32, n, elements=st.integers(-40_000, 40_000))) for _ in range(4)]
    accelerations = [np.where(valid, row * step, np.nan) for row, step in zip(counts, resolution, strict=True)]
    if draw(st.booleans()):
        accelerations[draw(st.integers(0, 3))] = draw(hnp.arrays(np.float64, n, elements=ANY_FLOAT))
    speed, distance = (draw(hnp.arrays(np.float64, n, elements=ANY_FLOAT)) for _ in range(2))
    quality = WindowQuality(
        *(draw(FINITE) for _ in range(2)), 3, *(draw(FINITE) for _ in range(5)), draw(st.booleans())
    )
    return Window(
        draw(st.text()), draw(st.text()), draw(st.integers(1, 16)), draw(st.integers(-(2**62), 2**62)), make.LENGTH,
        draw(FINITE), *accelerations, speed, distance, valid, resolution, draw(st.none() | st.text()), draw(FINITE),
        quality,
    )  # fmt: skip


@given(windows())
def test_any_window_comes_back_with_the_same_bits(window: Window) -> None:
    found = unpack_window(pack_window(window), where="here")
    assert same_values(found, window)
    assert make.same(found.quality, window.quality)
    assert window_digest(found) == window_digest(window)


def test_whole_counts_take_two_bytes_a_sample() -> None:
    counted = make.window(samples=4000)
    uncounted = replace(counted, **{name: getattr(counted, name) * 1.000001 for name in ACCELERATIONS})
    assert len(pack_window(counted)) < 4 * 2 * 4000 + 2 * 8 * 4000
    assert len(pack_window(uncounted)) > 4 * 6 * 4000
    assert same_values(unpack_window(pack_window(uncounted), where="here"), uncounted)


def test_the_lowest_and_highest_counts_are_kept_apart_from_the_missing_ones() -> None:
    window = make.window()
    values = np.array(window.lateral_acceleration)
    values[:4] = np.array([-32768, -32767, 32767, 32768]) * window.resolution[0]
    edge = replace(window, lateral_acceleration=values)
    assert same_values(unpack_window(pack_window(edge), where="here"), edge)


@given(
    step=st.sampled_from([0.0049, 2.0**-20, 1.0, -1.0, np.inf]),
    counts=hnp.arrays(np.int32, st.integers(1, 12), elements=st.integers(-32_769, 32_769)),
    other=st.none() | st.sampled_from([np.nan, -np.nan, np.inf, -0.0, 0.3, 5e-324, 1e308]),
    payload=st.booleans(),
)
def test_any_samples_come_back_with_the_same_bits(
    step: float, counts: np.ndarray, other: float | None, *, payload: bool
) -> None:
    values = counts * (step if np.isfinite(step) else 1.0)
    if other is not None:
        values[0] = other
    if payload:
        values.view(np.int64)[-1] = np.array(np.nan).view(np.int64) + 1
    window = make.window(samples=len(values))
    window = replace(window, resolution=(step, *window.resolution[1:]), **{ACCELERATIONS[0]: values})
    assert same_values(unpack_window(pack_window(window), where="here"), window)


NOT_STORED = {"backwards", "bridged", "frame_yaw_acceleration", "measures_gravity"}
"""They follow from the samples and the class of the vehicle."""


@pytest.mark.parametrize("name", [field.name for field in fields(Window) if field.name not in NOT_STORED])
def test_every_field_is_in_the_digest(name: str) -> None:
    window = make.window()
    value = getattr(window, name)
    if isinstance(value, np.ndarray):
        other = ~value if value.dtype == np.bool_ else np.nan_to_num(value) + 1.0
    elif isinstance(value, tuple):
        other = (*value[:-1], value[-1] * 2)
    elif isinstance(value, WindowQuality):
        other = replace(value, gaps=value.gaps + 1)
    else:
        other = value + "x" if isinstance(value, str) else value * 2 + 1
    assert window_digest(replace(window, **{name: other})) != window_digest(window)


def test_the_digest_is_the_same_in_another_process() -> None:
    here = Path(__file__).parent
    code = "import stored_values as make; from fleet_db.telemetry import window_digest as d; print(d(make.window(3)))"
    environment = os.environ | {"PYTHONPATH": f"{here}:{here.parent.parent}", "PYTHONHASHSEED": "7"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == window_digest(make.window(3))


@pytest.fixture
def files(tmp_path: Path) -> WindowFiles:
    return WindowFiles(tmp_path / "windows")


def test_save_and_load(files: WindowFiles) -> None:
    window = make.window()
    digest = window_digest(window)
    size = files.save(window, digest)
    assert files.has(digest, size)
    assert files.path(digest).stat().st_size == size
    assert same_values(files.load(digest), window)
    assert [path.name for path in files.directory.rglob("*") if path.is_file()] == [f"{digest}.window"]


def test_saving_again_leaves_the_file_alone(files: WindowFiles) -> None:
    window = make.window()
    digest = window_digest(window)
    files.save(window, digest)
    before = files.path(digest).stat()
    files.save(window, digest)
    assert files.path(digest).stat().st_ino == before.st_ino


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "other", "gone", "no window"])
def test_a_bad_file_is_named(files: WindowFiles, damage: str) -> None:
    window = make.window()
    digest = window_digest(window)
    files.save(window, digest)
    path = files.path(digest)
    blob = bytearray(path.read_bytes())
    blob[len(blob) // 2] ^= 0x10
    content = {
        "cut": bytes(blob[:-9]),
        "flipped": bytes(blob),
        "empty": b"",
        "other": pack_window(make.window(1)),
        "no window": b"PK\x03\x04" + bytes(100),
    }
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(content[damage])
    with pytest.raises(StorageError, match=digest):
        files.load(digest)
