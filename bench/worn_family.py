"""Write the table of conicities of worn design pairs: ``python -m bench.worn_family``.

Each row is one wheelset on one track: a wheel of a standard on a rail of a standard, new, worn hollow by a formula
(depth, place and width of the hollow, wear of the flange and of the rail drawn over their ranges, both wheels alike or
one less worn than the other), or worn by its contact and then run on that rail and on another, both new and worn; at
one gauge or blurred over several. A shape between two of the draws is like neither: fewer draws leave more wheelsets
that are like a few members only, which happen to stay flat.

Wear where contact is: a wheel that runs on a rail loses material in proportion to how often it is touched there.

The wheelset's lateral displacement is normal, with a share of curving in which the flange root of the outer wheel
touches. Each step takes a small depth off the profile, spread over the width of a contact patch, and finds the contact
points again (Archard's law at constant load). The tread becomes hollow and conforms to the rail, as in service; the
form follows from wheel, rail and motion and not from a formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.stats.qmc import Halton

from estimation.contact import wear
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import profile_from_points
from estimation.contact.wear import HOLLOWS, RailWear, TreadWear, worn, worn_rail
from estimation.errors import ContactError, ParameterError, ProfileError
from estimation.trend.extrapolation import AMPLITUDES, TABLE
from estimation.trend.parameters import CURVES
from estimation.values.arrays import FloatArray

STEP = 0.2e-3  # m of depth between two searches for contact
SERVICE_DISPLACEMENT = np.arange(-45, 46) * 0.2e-3  # m
CURVING_FROM = 4e-3  # m of displacement, of curves
SERVICE_GAUGES = (-1e-3, 0.0, 1e-3, 3e-3)  # m, deviation from 1435 mm
SERVICE_GAUGE_SHARES = np.array([0.2, 0.4, 0.25, 0.15])


@dataclass(frozen=True, slots=True)
class Running:
    """How a wheelset runs while its wheels wear."""

    spread: float  # m, standard deviation of the lateral displacement
    patch: float  # m, half the width over which a contact wears
    curving: float  # share of running in curves


def worn_by_contact(
    wheel: Profile, rail: Profile, inclination: float, running: Running, depths: tuple[float, ...]
) -> Iterator[Profile]:
    """Yield the wheel at each depth of wear.

    Args:
        wheel, rail: New profiles; both wheels and both rails are alike.
        depths: Greatest depths, m, increasing multiples of ``STEP``.

    Raises:
        ContactError: The profiles never touch.
    """
    shares = np.exp(-0.5 * (SERVICE_DISPLACEMENT / running.spread) ** 2)
    curving = SERVICE_DISPLACEMENT > CURVING_FROM
    shares = shares / shares.sum() + running.curving * curving / curving.sum()
    done = 0
    for depth in depths:
        while done < round(depth / STEP):
            wheel, done = _one_step(wheel, rail, inclination, running.patch, shares), done + 1
        yield wheel


def _one_step(wheel: Profile, rail: Profile, inclination: float, patch: float, shares: FloatArray) -> Profile:
    """Return the wheel after it has lost ``STEP`` where it is touched most; shares (n,) of displacements."""
    on_track = WheelsetOnTrack.symmetric(wheel, rail, inclination, 1.435)
    table = contact_table(on_track, SERVICE_DISPLACEMENT, SERVICE_GAUGES, method=ContactMethod.EN15302, outside="hold")
    share = (np.outer(shares, SERVICE_GAUGE_SHARES) * table.exists).ravel()
    apart = (wheel.y[:, np.newaxis] - table.contact_position_left.ravel()) / patch
    touched = np.where(np.abs(apart) < 1.0, (1.0 - apart**2) ** 2, 0.0) @ share
    return profile_from_points("wheel", f"{wheel.name} worn", wheel.y, wheel.z - STEP * touched / touched.max())


GAUGES = (-1e-3, 0.0, 1e-3, 2e-3, 3e-3)  # m, deviation from 1435 mm
GAUGE_SHARES = np.array(  # of the gauges: kept wide or narrow over the whole way, or varying
    [
        [0.0, 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
        [0.25, 0.5, 0.25, 0.0, 0.0],
        [0.0, 0.0, 0.25, 0.5, 0.25],
    ]
)
DISPLACEMENT = np.arange(-75, 76) * 1e-4  # m
DRAWS = 24  # of a pair
DEEPEST = 2.2e-3  # m, of a hollow
CENTRE_OFF = 7e-3  # m, of a hollow from its usual place, at most
WIDTHS = (0.65, 1.1)  # of its usual width
FLANGE_SHARE = 1.2  # greatest wear of the flange, in depths of the hollow
LESS_WORN = 0.6  # wear of one wheel in that of the other
UNLIKE = 0.4  # share of wheelsets with such wheels
WORN_RAILS = 0.5  # share of hollow wheels that run on such
RAIL_WORN, RAIL_CENTRE, RAIL_HALF_WIDTH = 1e-3, (-20e-3, 10e-3), 25e-3  # m, deepest band, where, and half its width
RUNNING = (Running(1.5e-3, 6e-3, 0.05), Running(3e-3, 8e-3, 0.25))
DEPTHS = (0.4e-3, 0.8e-3, 1.2e-3, 1.6e-3)  # m, of wear by contact
OTHER_RAIL = 3  # entries on in ``RAILS``
USUAL_CONICITY = (0.02, 0.8)  # at 3 mm; what is outside is no wheelset in service
MOST_CONICITY = 1.2  # at any amplitude
RAILS = (  # with the inclinations they are laid at
    ("56E1", (20,)),
    ("60E1", (20, 40)),
    ("60E2", (40,)),
    ("54E1", (20,)),
    ("49E1", (40,)),
    ("49E5", (40,)),
    ("46E1", (20,)),
    ("50E1", (20, 40)),
)


@dataclass(frozen=True, slots=True)
class Pair:
    """A design wheel on a design rail, and where its hollow forms."""

    wheel: str
    rail: str
    inclination: int  # 1 : inclination
    centre: float  # m
    half_width: float  # m


PAIRS = tuple(
    Pair(wheel, rail, inclination, centre, half_width)
    for wheel, (centre, half_width) in HOLLOWS.items()
    for rail, inclinations in RAILS
    for inclination in inclinations
)


def conicities_of(pair: Pair) -> FloatArray:
    """Return the conicities (m, a) of a pair, new and worn, at ``AMPLITUDES``, as far as they are usual in service."""
    found = [conicities_on_track(*wheels, rail, pair.inclination) for wheels, rail in wheelsets(pair)]
    rows = np.concatenate(found)
    low, high = USUAL_CONICITY
    usual = (rows[:, -1] >= low) & (rows[:, -1] <= high) & (rows.max(axis=1) <= MOST_CONICITY)
    return np.asarray(rows[usual])


def conicities_on_track(left: Profile, right: Profile, rail: Profile, inclination: int) -> FloatArray:
    """Return the conicities (g, a) of a wheelset at ``AMPLITUDES``, for each of the ``GAUGE_SHARES``."""
    on_track = WheelsetOnTrack(left, right, rail, rail, 1.0 / inclination, 1.435)
    table = contact_table(on_track, DISPLACEMENT, GAUGES, method=ContactMethod.EN15302, outside="hold")
    curves = GAUGE_SHARES @ table.rolling_radius_difference.T
    return np.stack([equivalent_conicity(DISPLACEMENT, curve, AMPLITUDES) for curve in curves])


def wheelsets(pair: Pair) -> Iterator[tuple[tuple[Profile, Profile], Profile]]:
    """Yield left and right wheel of each wheelset, with the rail it runs on."""
    wheel, rail = wheel_profile(pair.wheel), rail_profile(pair.rail)
    yield (wheel, wheel), rail
    for left, right, band in _hollows(pair):
        yield (worn(wheel, left), worn(wheel, right)), worn_rail(rail, band)
    names = [name for name, _ in RAILS]
    other = rail_profile(names[(names.index(pair.rail) + OTHER_RAIL) % len(names)])
    for running, bands in zip(RUNNING, _bands(pair), strict=True):
        try:
            shapes = worn_by_contact(wheel, rail, 1.0 / pair.inclination, running, DEPTHS)
            for shape, band in zip(shapes, bands, strict=True):
                for under in (rail, other):
                    yield (shape, shape), under
                    yield (shape, shape), worn_rail(under, band)
        except ContactError:
            continue  # worn so that it no longer touches: no wheel in service


def _hollows(pair: Pair) -> Iterator[tuple[TreadWear, TreadWear, RailWear]]:
    """Yield the wear of left wheel, right wheel and rails, drawn over its ranges; each pair has draws of its own."""
    draws = Halton(7, scramble=False)
    draws.fast_forward(1 + DRAWS * PAIRS.index(pair))
    for depth_share, place, width, flange, unlike, rail, band in draws.random(DRAWS):
        depth, centre = DEEPEST * depth_share, pair.centre + CENTRE_OFF * (2.0 * place - 1.0)
        half_width = pair.half_width * (WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * width)
        less = LESS_WORN if unlike < UNLIKE else 1.0
        flange_wear = FLANGE_SHARE * flange * depth
        yield (
            TreadWear(depth, centre, half_width, flange_wear),
            TreadWear(less * depth, centre, half_width, less * flange_wear),
            _rail_wear(max(0.0, rail - WORN_RAILS) / WORN_RAILS, band),
        )


def _bands(pair: Pair) -> Iterator[list[RailWear]]:
    """Yield for each way of running the wear of the rails under the wheel of each depth, drawn as that of hollows."""
    draws = Halton(2, scramble=False)
    draws.fast_forward(1 + len(RUNNING) * len(DEPTHS) * PAIRS.index(pair))
    for _ in RUNNING:
        yield [_rail_wear(*shares) for shares in draws.random(len(DEPTHS))]


def _rail_wear(depth_share: float, place_share: float) -> RailWear:
    centre = RAIL_CENTRE[0] + (RAIL_CENTRE[1] - RAIL_CENTRE[0]) * place_share
    return RailWear(RAIL_WORN * depth_share, centre, RAIL_HALF_WIDTH)


def main() -> None:
    """Compute every pair and write the table beside its module."""
    parts = []
    for index, pair in enumerate(PAIRS):
        rows = np.round(conicities_of(pair) / CURVES.stored_unit)
        parts.append(np.column_stack([np.full(len(rows), index), rows]))
    np.save(Path(wear.__file__).with_name(TABLE), np.concatenate(parts).astype(np.uint16))


if __name__ == "__main__":
    main()


LINE_RAILS = (("56E1", 20), ("60E1", 40), ("60E1", 20), ("54E1", 20), ("60E2", 40), ("49E5", 40))
STANDARDS = (  # with centre and half width of the hollow, m: where contact is
    ("P8", 3e-3, 44e-3),
    ("S1002", 4e-3, 33e-3),
    ("EN13715-1/40/h28/e32.5", 3e-3, 38e-3),
)
OTHER_WHEELS = (("EN13715-1/40/h30/e29", 3e-3, 38e-3), ("EN13715-S1002/h28/e31.5", 4e-3, 35e-3))
GAUGE_OFFSETS = np.array([-1.2e-3, -0.6e-3, 0.0, 0.6e-3, 1.2e-3])  # m about the mean gauge of a line
LINE_GAUGE_SHARES = np.array([0.1, 0.25, 0.3, 0.25, 0.1])
MEAN_GAUGES = (-0.5e-3, 3e-3)  # m, deviation
GRID = 0.25e-3  # m

_Draw = Callable[[np.random.Generator], tuple[Profile, Profile, int]]  # wheel, rail, 1 : inclination


def curve_of(kind: str, random: np.random.Generator) -> FloatArray | None:
    """Return the rolling radius difference (n,), m, at ``DISPLACEMENT`` of a worn wheelset; None where none runs."""
    try:
        wheel, rail, inclination = CLASSES[kind](random)
        gauge = random.uniform(*MEAN_GAUGES) + GAUGE_OFFSETS
        on_track = WheelsetOnTrack.symmetric(wheel, rail, 1.0 / inclination, 1.435)
        table = contact_table(on_track, DISPLACEMENT, gauge, method=ContactMethod.EN15302, outside="hold")
    except (ContactError, ProfileError, ParameterError):
        return None
    return np.asarray(table.rolling_radius_difference @ LINE_GAUGE_SHARES)


def _rail(random: np.random.Generator, deepest: float = 0.0) -> tuple[Profile, int]:
    name, inclination = LINE_RAILS[random.integers(len(LINE_RAILS))]
    band = RailWear(random.uniform(0.0, deepest), random.uniform(-20e-3, 10e-3), random.uniform(20e-3, 30e-3))
    return worn_rail(rail_profile(name), band), inclination


def _hollow(wheels: Sequence[tuple[str, float, float]], random: np.random.Generator, off: float = 4e-3) -> Profile:
    """Return one of the wheels, hollow, the hollow at most so far off its usual place (m)."""
    name, centre, half_width = wheels[int(random.integers(len(wheels)))]
    depth = random.uniform(0.3e-3, 2.2e-3)
    place, width = centre + random.uniform(-off, off), half_width * random.uniform(0.75, 1.1)
    return worn(wheel_profile(name), TreadWear(depth, place, width, random.uniform(0.3, 1.2) * depth))


def _standard(random: np.random.Generator) -> Profile:
    return wheel_profile(STANDARDS[random.integers(len(STANDARDS))][0])


def _other_wheel(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    return _hollow(OTHER_WHEELS, random), *_rail(random)


def _on_worn_rail(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    return _hollow(STANDARDS, random), *_rail(random, 1e-3)


def _by_contact(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    running = Running(random.uniform(1.8e-3, 4e-3), random.uniform(5e-3, 10e-3), random.uniform(0.0, 0.4))
    rail, inclination = _rail(random)
    depth = 0.2e-3 * random.integers(2, 10)
    wheel = next(iter(worn_by_contact(_standard(random), rail, 1.0 / inclination, running, (depth,))))
    return wheel, *_rail(random, 1e-3)


def _arc(random: np.random.Generator) -> tuple[Profile, Profile, int]:
    """Return a tread that is a concave arc for a part, rounded at its ends."""
    wheel = _standard(random)
    y = np.arange(wheel.y[0], wheel.y[-1], GRID)
    centre, radius, depth = random.uniform(-10e-3, 8e-3), random.uniform(0.31, 0.6), random.uniform(0.3e-3, 2e-3)
    at = np.array([centre])
    tilt = random.uniform(0.8, 1.3) * float(wheel.gradient(at)[0])
    arc = float(wheel.height(at)[0]) - depth + tilt * (y - centre) + (y - centre) ** 2 / (2.0 * radius)
    lost = np.where(y < -36e-3, 0.0, np.clip(wheel.height(y) - arc, 0.0, 3e-3))
    rounding = np.exp(-0.5 * (GRID * np.arange(-24, 25) / random.uniform(1e-3, 3e-3)) ** 2)
    lost = np.convolve(lost, rounding / rounding.sum(), "same")
    return profile_from_points("wheel", "arc", y, wheel.height(y) - lost), *_rail(random)


CLASSES: dict[str, _Draw] = {
    "another wheel, hollow": _other_wheel,
    "arc worn": _arc,
    "hollow on worn rails": _on_worn_rail,
    "worn by contact, worn rails": _by_contact,
}


LENGTH, TRACK_STEP, STARTS = 3000.0, 0.1, 200.0  # m
WAVES = (3.0, 60.0)  # m
TWICE_L_R0 = 2.0 * 0.7452 * 0.45  # m2
BEYOND = 0.0025  # of the running is beyond the amplitude that is covered, on either side


def amplitude_reached(curves: FloatArray, irregularity: FloatArray, kappa: FloatArray, seed: int) -> FloatArray:
    """Return the amplitude (m,), m, that each wheelset covers.

    Args:
        curves: (m, n) m, rolling radius difference at ``DISPLACEMENT``.
        irregularity: (m,) m, standard deviation of the alignment.
        kappa: (m,) 1/m.
    """
    slope = _alignment_slope(seed)
    x, yaw, travelled = np.zeros(len(curves)), np.zeros(len(curves)), []
    first, spacing, flat = DISPLACEMENT[0], DISPLACEMENT[1] - DISPLACEMENT[0], curves.ravel()
    begin = curves.shape[1] * np.arange(len(curves))
    for change in slope:
        x = np.clip(x + TRACK_STEP * (yaw - irregularity * change), 0.99 * first, -0.99 * first)
        place = (x - first) / spacing
        node = place.astype(np.int64)
        share = place - node
        radius = (1.0 - share) * flat[begin + node] + share * flat[begin + node + 1]
        yaw = yaw - TRACK_STEP * (radius / TWICE_L_R0 + kappa * yaw)
        travelled.append(x.astype(np.float32))
    low, high = np.quantile(np.array(travelled)[int(STARTS / TRACK_STEP) :], [BEYOND, 1.0 - BEYOND], axis=0)
    return np.asarray(np.minimum(-low, high), dtype=np.float64)


def _alignment_slope(seed: int) -> FloatArray:
    """Return the slope of an alignment of unit standard deviation at every step."""
    band = butter(2, [2.0 * TRACK_STEP / wave for wave in reversed(WAVES)], "band", output="sos")
    noise = np.random.default_rng(seed).standard_normal(round(LENGTH / TRACK_STEP))
    alignment = sosfiltfilt(band, np.cumsum(sosfiltfilt(band, noise)))
    return np.asarray(np.gradient(alignment / alignment.std(), TRACK_STEP))
