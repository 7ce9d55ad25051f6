"""How far a geometry must jump, and how well a mistake must explain it, against distances written out by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from wheelset_life import geometry_of

from estimation.alerts.identity import (
    IdentityEvent,
    IdentityParameters,
    Mistake,
    Observation,
    identity_events,
    reversed_between,
    swapped_between,
)
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues

EDGES = 0.25e-3 * np.arange(-16, 17)
AT = 0.5 * (EDGES[1:] + EDGES[:-1])
P = IdentityParameters()
STD = 1e-5


def seen(
    number: int, curve: Callable[[FloatArray], FloatArray], *, serial: str = "A", km: float = 0.0, **changes: object
) -> Observation:
    """Return what was seen of a wheelset in the hundred ns from ``100 number`` on; ``known`` says of which bins."""
    known = np.asarray(changes.pop("known", np.ones(len(AT), dtype=bool)), dtype=bool)
    std, windows = changes.pop("std", STD), changes.pop("windows", 8)
    status = tuple(BinStatus.ESTIMATED if one else BinStatus.TOO_FEW for one in known)
    radius = BinValues(np.where(known, curve(AT), np.nan), np.where(known, std, np.nan), status)  # type: ignore[call-overload]
    nothing = BinValues(np.full(len(AT), np.nan), np.full(len(AT), np.nan), (BinStatus.UNOBSERVABLE,) * len(AT))
    geometry = replace(
        geometry_of(conicity=0.2),
        bin_edges=EDGES,
        samples=np.ones(len(AT)),
        rolling_radius_difference=radius,
        rolling_radius_sum=nothing,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        windows=windows,
    )
    found = Observation(serial, 100 * number, 100 * number + 99, km, geometry)
    return replace(found, **changes)  # type: ignore[arg-type]


def even_part(amplitude: float, slope: float = 0.0) -> Callable[[FloatArray], FloatArray]:
    """Return R(x) = slope x and a cosine of one wavelength in 3.5 mm, which has no mean level to speak of."""
    return lambda x: slope * x + amplitude * np.cos(2 * np.pi * x / 3.5e-3)


def by_hand(
    a: FloatArray, b: FloatArray, std_a: FloatArray, std_b: FloatArray, worn: float, p: IdentityParameters = P
) -> float:
    """Return the rms of b - a in standard deviations, with a level of its own, one bin after the other."""
    variance = [
        1.4**2 * (sa**2 + sb**2) + 0.004e-3**2 + (0.02 * 0.5 * (x + y)) ** 2 + worn**2
        for x, y, sa, sb in zip(a, b, std_a, std_b, strict=True)
    ]
    assert (p.trusted_std, p.floor, p.relative, p.level) == (1.4, 0.004e-3, 0.02, 0.01e-3)
    level = sum((y - x) / v for x, y, v in zip(a, b, variance, strict=True)) / (
        sum(1 / v for v in variance) + 1 / 0.01e-3**2
    )
    terms = [(y - x - level) ** 2 / v for x, y, v in zip(a, b, variance, strict=True)]
    return float(np.sqrt(sum(terms) / len(terms)))


@pytest.mark.parametrize("level", [0.0, 1.2e-5, -1.2e-5])
def test_what_a_turned_wheelset_leaves_is_the_distance_to_its_mirror_image(level: float) -> None:
    before, shape = even_part(4e-5, 0.01), even_part(-3.6e-5, 0.0104)

    def after(x: FloatArray) -> FloatArray:
        return shape(x) + level

    found = reversed_between(seen(0, before, km=3000.0), seen(1, after, km=3500.0))
    assert found is not None
    right = (AT > 0.0) & (AT <= 3.5e-3)
    x, wide = AT[right], AT[np.abs(AT) <= 3.5e-3]
    half = np.full(len(x), STD / np.sqrt(2.0))
    even_before, even_after = 0.5 * (before(x) + before(-x)), 0.5 * (after(x) + after(-x))
    worn = 0.02e-3 * 500.0 / 1000.0
    assert found.jump == pytest.approx(by_hand(even_before, even_after, half, half, 0.3 * worn), rel=1e-9)
    mirrored = by_hand(-even_before, even_after, half, half, 0.3 * worn)
    whole = by_hand(-before(-wide), after(wide), np.full(len(wide), STD), np.full(len(wide), STD), worn)
    assert found.left == pytest.approx(max(mirrored, whole), rel=1e-9)
    assert mirrored > whole
    assert (found.before_ns, found.after_ns, found.measured_ns) == (99, 100, 199)
    assert (found.mistake, found.partner, found.wheelset) == (Mistake.REVERSED, None, "A")


def test_the_worse_of_both_explanations_counts() -> None:
    found = reversed_between(seen(0, even_part(4e-5, 0.01)), seen(1, even_part(-4e-5, 0.03)))
    assert found is None  # its odd part is another
    close = reversed_between(seen(0, even_part(4e-5, 0.01)), seen(1, even_part(-4e-5, 0.0115)))  # its odd part nearly
    assert close is not None
    assert close.left > 0.1


def bare(**changes: float) -> IdentityParameters:
    """Return parameters under which a distance is the difference over 1e-5 m."""
    plain = IdentityParameters(trusted_std=0.0, floor=1e-5, relative=0.0, wear_per_1000_km=0.0, level=1e-12)
    return replace(plain, **changes)  # type: ignore[arg-type]


def turned(jump: float, left: float) -> tuple[Observation, Observation]:
    """Return before and after of a jump in standard deviations that its mirror image explains but for ``left``."""
    x = AT[(AT > 0.0) & (AT <= 3.5e-3)]
    size = 1e-5 / float(np.sqrt(np.mean(even_part(1.0)(x) ** 2)))
    before, after = 0.5 * (jump + left), 0.5 * (jump - left)
    return seen(0, even_part(before * size)), seen(1, even_part(-after * size))


@pytest.mark.parametrize(
    ("jump", "left", "explained"),
    [
        (1.99, 0.0, False),
        (2.01, 0.0, True),
        (4.0, 1.19, True),
        (4.0, 1.21, False),
        (2.2, 1.09, True),
        (2.2, 1.11, False),
    ],
)
def test_a_turn_jumps_by_two_and_leaves_little(jump: float, left: float, *, explained: bool) -> None:
    found = reversed_between(*turned(jump, left), bare())
    assert (found is not None) is explained
    if found is not None:
        assert (found.jump, found.left) == (pytest.approx(jump, rel=1e-6), pytest.approx(left, rel=1e-3, abs=1e-9))


def test_only_the_bins_within_reach_count_and_eight_are_needed() -> None:
    before, after = turned(4.0, 0.0)

    def two_steps(x: FloatArray) -> FloatArray:
        return 4e-5 * np.where(np.abs(x) < 0.5e-3, 1.0, -1.0)

    for bins, explained in ((8, True), (6, False)):
        near = np.abs(AT) < 0.5 * bins * 0.25e-3
        pair = seen(0, two_steps, known=near), seen(1, lambda x: -two_steps(x), known=near)
        assert (reversed_between(*pair, bare()) is not None) is explained
    # what differs beyond 3.5 mm is not looked at; what differs just within is
    for at, ignored in ((3.625e-3, True), (3.375e-3, False)):

        def bent(x: FloatArray, at: float = at) -> FloatArray:
            return np.where(np.abs(np.abs(x) - at) < 1e-9, 1e-3, 0.0)

        spoiled = replace(after, geometry=with_curve(after, bent))
        assert (reversed_between(before, spoiled, bare()) is not None) is ignored


def with_curve(item: Observation, extra: Callable[[FloatArray], FloatArray]) -> object:
    radius = item.geometry.rolling_radius_difference
    return replace(item.geometry, rolling_radius_difference=replace(radius, value=radius.value + extra(AT)))


def test_four_bins_of_the_even_part_are_needed() -> None:
    def two_steps(x: FloatArray) -> FloatArray:
        return 4e-5 * np.where(np.abs(x) < 0.5e-3, 1.0, -1.0)

    for left, explained in ((4, True), (3, False)):
        after = seen(1, lambda x: -two_steps(x), known=-left * 0.25e-3 < AT)
        assert (reversed_between(seen(0, two_steps), after, bare()) is not None) is explained


def test_bins_that_differ_are_not_compared() -> None:
    before, after = turned(4.0, 0.0)
    shifted = replace(after, geometry=replace(after.geometry, bin_edges=EDGES + 1e-4))
    assert reversed_between(before, shifted, bare()) is None
    fewer = replace(seen(1, even_part(1e-5)), geometry=geometry_of(conicity=0.2))
    assert reversed_between(before, fewer, bare()) is None


def swapped(jump: float, left: float, *, second: float = 0.0) -> list[tuple[Observation, Observation]]:
    """Return two wheelsets that differ by ``jump`` std and become each other's but for ``left``."""
    size = 1e-5 / float(np.sqrt(np.mean(even_part(1.0)(AT[np.abs(AT) <= 3.5e-3]) ** 2)))
    a, b = even_part(0.0), even_part((jump - left) * size)
    a_after, b_after = even_part(jump * size), even_part(-left * size)
    return [
        (seen(0, a, serial="A"), seen(1, a_after, serial="A")),
        (seen(0, b, serial="B", km=second), seen(1, b_after, serial="B")),
    ]


@pytest.mark.parametrize(
    ("jump", "left", "explained"),
    [
        (1.99, 0.0, False),
        (2.01, 0.0, True),
        (4.0, 1.19, True),
        (4.0, 1.21, False),
        (2.2, 1.09, True),
        (2.2, 1.11, False),
    ],
)
def test_a_swap_jumps_by_two_and_leaves_little(jump: float, left: float, *, explained: bool) -> None:
    found = swapped_between(*swapped(jump, left), bare())
    assert (found is not None) is explained
    if found is not None:
        assert [one.jump for one in found] == [pytest.approx(jump, rel=1e-6)] * 2
        assert [one.left for one in found] == [pytest.approx(left, abs=1e-6)] * 2
        assert [(one.wheelset, one.partner, one.mistake) for one in found] == [
            ("A", "B", Mistake.SWAPPED),
            ("B", "A", Mistake.SWAPPED),
        ]


def test_the_worse_of_both_wheelsets_decides_on_a_swap() -> None:
    size = 1e-5 / float(np.sqrt(np.mean(even_part(1.0)(AT[np.abs(AT) <= 3.5e-3]) ** 2)))
    for first_left, second_left in ((0.5, 1.1), (1.1, 0.5), (0.5, 1.3), (1.3, 0.5)):
        curves = (0.0, 4.0 + first_left), (4.0, second_left)  # before and after of both, in std
        pairs = [
            (seen(0, even_part(a * size), serial=serial), seen(1, even_part(b * size), serial=serial))
            for serial, (a, b) in zip("AB", curves, strict=True)
        ]
        found = swapped_between(pairs[0], pairs[1], bare())
        assert (found is not None) is (max(first_left, second_left) < 1.2)
        if found is not None:
            assert [one.left for one in found] == pytest.approx([first_left, second_left], abs=1e-6)
            assert [one.jump for one in found] == pytest.approx([4.0 + first_left, 4.0 - second_left])


def test_a_swap_is_at_one_time() -> None:
    first, second = swapped(4.0, 0.0)
    later = tuple(replace(one, from_ns=one.from_ns + 50, to_ns=one.to_ns + 50) for one in second)
    found = swapped_between(first, later, bare())  # type: ignore[arg-type]
    assert found is None  # A had changed at 100, B not before 149
    gap = (second[0], replace(second[1], from_ns=150, to_ns=250))
    one, other = swapped_between(first, gap, bare()) or (None, None)
    assert one is not None
    assert other is not None
    assert (one.before_ns, one.after_ns) == (99, 100)
    assert (other.before_ns, other.after_ns) == (99, 100)
    touching = (replace(second[0], to_ns=100), second[1])
    assert swapped_between(first, touching, bare()) is not None
    assert swapped_between(first, (replace(second[0], to_ns=101), second[1]), bare()) is None


def test_the_wear_allowed_to_a_swap_is_that_of_the_longer_way() -> None:
    wearing = bare(wear_per_1000_km=0.02e-3)
    alike = swapped_between(*swapped(4.0, 0.0), wearing)
    further = swapped_between(*swapped(4.0, 0.0, second=1000.0), wearing)
    assert alike is not None
    assert alike[0].jump == pytest.approx(4.0)
    assert further is None  # 4 / sqrt(1 + 4) = 1.79
    assert swapped_between(*swapped(4.6, 0.0, second=1000.0), wearing) is not None


def history(*pieces: Observation) -> dict[str, list[Observation]]:
    return {"A": list(pieces)}


def numbered(number: int, item: Observation) -> Observation:
    return replace(item, from_ns=100 * number, to_ns=100 * number + 99)


def test_the_interval_with_both_in_it_is_left_out() -> None:
    before, after = turned(6.0, 0.0)
    x = AT[(AT > 0.0) & (AT <= 3.5e-3)]
    mixed = seen(1, even_part(0.0))
    assert len(x) == 14
    pieces = [before, mixed, numbered(2, after)]
    found = identity_events(history(*pieces), bare())["A"]
    assert (found.before_ns, found.after_ns, found.jump) == (99, 200, pytest.approx(6.0))
    assert identity_events(history(before, mixed), bare()) == {}
    assert identity_events(history(before, after), bare())["A"].after_ns == 100
    again = identity_events(history(before, after, numbered(2, after)), bare())["A"]
    assert (again.before_ns, again.after_ns) == (99, 100)
    late = identity_events(history(before, numbered(1, before), numbered(2, after)), bare())["A"]
    assert (late.before_ns, late.after_ns) == (199, 200)


def test_a_geometry_needs_three_windows_to_speak() -> None:
    before, after = turned(6.0, 0.0)
    for windows, counted in ((2, False), (3, True)):
        few = replace(after, geometry=replace(after.geometry, windows=windows))
        assert ("A" in identity_events(history(before, few), bare())) is counted


def test_the_even_part_alone_may_show_the_jump() -> None:
    # all of R wears alike over 1000 km, its even part by 0.3 of it
    wearing = bare(wear_per_1000_km=0.02e-3)
    before, after = turned(3.0, 0.0)
    found = identity_events(history(before, replace(after, mileage_km=1000.0)), wearing)
    assert found["A"].jump == pytest.approx(3.0 / np.hypot(1.0, 0.3 * 2.0), rel=1e-6)
    far = identity_events(history(before, replace(after, mileage_km=2300.0)), wearing)
    assert far == {}  # 3 / hypot(1, 1.38) = 1.76


def test_a_swap_goes_before_a_turn_that_explains_less_and_is_reported_of_both() -> None:
    first, second = swapped(4.0, 0.0)
    found = identity_events({"A": list(first), "B": list(second)}, bare())
    assert {serial: event.partner for serial, event in found.items()} == {"A": "B", "B": "A"}
    third = tuple(replace(one, wheelset="C") for one in second)
    crowd: dict[str, IdentityEvent] = identity_events(
        {"A": list(first), "B": list(second), "C": list(third)},  # type: ignore[dict-item]
        bare(),
    )
    assert {serial: event.partner for serial, event in crowd.items()} == {"A": "B", "B": "A"}
    # a turn that leaves nothing is kept against a swap that leaves something
    before, after = turned(4.0, 0.0)
    size = 4e-6
    near = [
        (replace(before, wheelset="A"), replace(after, wheelset="A")),
        (
            replace(after, wheelset="B", from_ns=0, to_ns=99, geometry=with_curve(after, even_part(size))),
            replace(before, wheelset="B", from_ns=100, to_ns=199, geometry=with_curve(before, even_part(size))),
        ),
    ]
    assert swapped_between(*near, bare()) is not None  # type: ignore[arg-type]
    kept = identity_events({"A": list(near[0]), "B": list(near[1])}, bare())
    assert kept["A"].mistake is Mistake.REVERSED


def test_the_shipped_parameters() -> None:
    assert (P.wear_per_1000_km, P.uneven, P.least_jump, P.most_left, P.least_gain) == (0.02e-3, 0.3, 2.0, 1.2, 2.0)
    assert (P.reach, P.least_bins, P.least_windows) == (3.5e-3, 8, 3)
