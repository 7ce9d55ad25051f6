"""The bench of refusals: what it draws, what it says of a vehicle, and what its page of results claims."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.refusals import (
    HEADER,
    SKIPPED,
    WRONG_HEADER,
    interval_rows,
    radius_rows,
    run_seed,
    summary_rows,
    wrong_rows,
)
from bench.refusals_case import DIMENSIONS, OnFile, drawn_case, judged, registered, simulated

PAGE = Path(__file__).parents[2] / "docs" / "results" / "refusals.md"


def line(kind: str, *, withheld: bool = False, doubted: bool = False, published: bool = True) -> dict[str, object]:
    return {
        "seed": 0, "kind": kind, "drawn": drawn_case(0), "published": published, "withheld": withheld,
        "doubted": doubted, "code": "why" if withheld or doubted else "", "errors": [0.01], "covered": [True],
        "axle": 0, "values": [0.1], "radius": None,
    }  # fmt: skip


def test_every_kind_of_every_dimension_is_drawn() -> None:
    drawn = [drawn_case(seed) for seed in range(100)]
    for name, kinds in DIMENSIONS.items():
        assert {one[name] for one in drawn} == set(kinds)
    assert drawn_case(3) == drawn[3]
    assert drawn_case(3, track="level")["track"] == "level"


def test_a_push_pull_train_is_right_on_both_journeys_and_its_exchanged_nodes_are_found() -> None:
    case = simulated(
        7, 2, arrangement="push-pull bogie", sensors="quiet", vibration="0", pair="new P8", speed="20",
        track="cross level", survey="0.1",
    )  # fmt: skip
    for one, conicity in zip(judged(case, OnFile.RIGHT), case.conicity, strict=True):
        assert (one.published, one.withheld, one.doubted) == (True, False, False)
        assert np.max(np.abs(one.errors)) < 0.1 * float(np.max(conicity))
    for wrong in (OnFile.EXCHANGED, OnFile.DEAD_FRAME, OnFile.RADIUS_HIGH):
        assert all(one.withheld or one.doubted for one in judged(case, wrong)), wrong


def test_what_is_wrong_is_on_file() -> None:
    case = simulated(7, 1, arrangement="soft bogie", pair="new P8", speed="12", vibration="0")
    right = case.vehicle_class
    assert right.bogie is not None
    assert registered(right, OnFile.RIGHT).parameters == right.parameters
    high = registered(right, OnFile.RADIUS_HIGH).parameters.nominal_radius
    assert high == pytest.approx(1.1 * right.parameters.nominal_radius)
    short = registered(right, OnFile.WHEELBASE).bogie
    assert short is not None
    assert short.wheelbase == pytest.approx(0.7 * right.bogie.wheelbase)
    assert registered(right, OnFile.CLASS).bogie is None


def test_rows_count_what_is_withheld_and_in_doubt() -> None:
    found = [line("right") for _ in range(98)] + [
        line("right", withheld=True, published=False),
        line("right", doubted=True),
    ]
    first = dict(zip(HEADER, summary_rows(found)[0], strict=True))
    assert (first["row"], first["wheelsets"], first["withheld"], first["in doubt"]) == ("all", "100", "1", "1")
    assert first["met"] == "yes"
    worse = summary_rows([*found, line("right", withheld=True, published=False)])[0]
    assert worse[-1] == "NO"
    (wrong,) = wrong_rows([*(line("radius +10 %", doubted=True) for _ in range(99)), line("radius +10 %")])
    assert wrong[-1] == "yes"
    (wrong,) = wrong_rows([*(line("radius +10 %", doubted=True) for _ in range(98)), line("radius +10 %")])
    assert wrong[-1] == "NO"


def test_an_open_radius_is_a_doubt_on_a_radius_alone_and_what_a_mistake_moves_is_counted() -> None:
    open_radius = {**line("right", doubted=True), "code": "rolling_radius_open", "values": [0.11, None]}
    before = {**line("right"), "values": [0.1, 0.2], "radius": (-0.05, 0.03, 0.01)}
    for kind, share in (("radius +10 %", "100 %"), ("wheelbase -30 %", "0 %")):
        (row,) = wrong_rows([before, {**open_radius, "kind": kind}])
        said = dict(zip(WRONG_HEADER, row, strict=True))
        assert (said["found"], said["moved"], said["covers"]) == (share, "+10 %", "100 %")
    (row,) = radius_rows([before, {**before, "radius": (0.03, 0.03, 0.01)}])
    assert row == ("{track}, {sensors}".format(**before["drawn"]), "2", "-1.0 / 4.4", "3.0", "1.0", "1")  # type: ignore[arg-type]


def test_intervals_are_counted_by_sensors_and_speed() -> None:
    drawn = dict(line("right")["drawn"])  # type: ignore[call-overload]
    held, missed, slow = (
        {**line("right"), "drawn": drawn | {"sensors": "mems", "speed": speed}, "covered": covered}
        for speed, covered in (("20", [True] * 3), ("20", [False]), ("12", []))
    )
    wrong = {**line("radius +10 %"), "drawn": missed["drawn"]}
    first, second = interval_rows([held, missed, slow, wrong])
    assert (*first[:3], first[-1]) == ("mems, 12", "1", "0.0", "")
    assert (*second[:3], second[-1]) == ("mems, 20", "2", "2.0", "75.0 %")


def test_a_seed_that_derails_is_skipped() -> None:
    (only,) = run_seed(3, 1, 3)
    assert only["kind"] == SKIPPED


def page_rows() -> list[dict[str, str]]:
    table = next(row for row in PAGE.read_text(encoding="utf-8").split("\n\n") if row.startswith("| row |"))
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def test_the_page_has_right_wheelsets_of_every_kind_and_holds_its_rows() -> None:
    """At most 1 % of them are withheld, and 3 % in any row; two of a row of fewer than 100 may be chance."""
    every, *rows = page_rows()
    assert int(every["wheelsets"]) >= 300
    assert int(every["withheld"]) <= 0.01 * int(every["wheelsets"])
    names = {f"{name}: {kind}" for name, kinds in DIMENSIONS.items() for kind in kinds}
    assert {row["row"] for row in rows} == names
    for row in rows:
        assert int(row["withheld"]) <= max(0.03 * int(row["wheelsets"]), 2), row
