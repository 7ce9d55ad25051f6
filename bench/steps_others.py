"""Wheelsets turned end for end, by how much their wheels differ: found by the history, and by intervals in pairs.

The curves are those of a hollow wheel beside one that is hollower, from the contact geometry. Their errors are mostly
common to all intervals (0.03 in conicity, and an error of the track), with sampling noise of 0.003 besides.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import numpy as np

from bench.made_values import made_geometry
from bench.report import BenchRow
from bench.steps_lives import BEGIN_NS
from estimation.alerts.identity import Mistake, Observation, identity_events, reversed_between
from estimation.alerts.rules.running_gear import SuspensionChangeRule, suspension_change_finding
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import TreadWear, worn
from estimation.trend.suspension import suspension_histories
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues
from estimation.values.trend import SuspensionFinding
from estimation.values.units import DAY_NS, HOUR_NS, YEAR_NS

EDGES: FloatArray = 0.25e-3 * np.arange(-14, 15, dtype=np.float64)
AT = 0.5 * (EDGES[1:] + EDGES[:-1])
DISPLACEMENT = np.arange(-75, 76) * 1e-4  # m
PAIRS = (("P8", "56E1", 20, 3e-3, 44e-3), ("S1002", "60E1", 40, 4e-3, 33e-3))
HOLLOW, DIFFERENCES = 0.7e-3, (0.1e-3, 0.3e-3, 1.0e-3)  # m, of the less worn wheel, and how much more the other is
INTERVAL_KM = (1000.0, 10_000.0)  # every third day, and once a month
BEFORE, BEHIND = 12, 8  # intervals
COMMON, NOISE, TRACK = 0.03, 0.003, 0.01e-3  # conicity; conicity; m of R
WEAR_PER_KM = 2e-7  # of the hollow, relative
FEW = 4  # intervals within which it is to be found


def turned_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield how soon turned wheelsets are found, and how often right ones are."""
    for difference in (0.0, *DIFFERENCES):
        found, pairs, total = 0, 0, 0
        sizes = []
        for number, pair in enumerate(PAIRS):
            sizes.append(float(np.sqrt(np.mean(_even(curve(*pair, difference)) ** 2))))
            for km in INTERVAL_KM:
                for i in range(lives):
                    seen = _life(pair, difference, km, np.random.default_rng(seed + 100 * number + i))
                    total += 1
                    found += _found(seen[: BEFORE + FEW])
                    pairs += any(reversed_between(*two) for two in pairwise(seen))
        even = " and ".join(f"{1e3 * size:.2f}" for size in sizes)
        what = f"turned end for end, one wheel hollower by {1e3 * difference:g} mm (even part {even} mm rms)"
        text = f"{found} of {total} found within {FEW} intervals; {pairs} by intervals in pairs"
        must = difference >= DIFFERENCES[2]
        yield BenchRow(what, text, "90 %" if must else "for information", not must or found >= 0.9 * total)
    wrong = sum(
        bool(identity_events({"W": _life(pair, DIFFERENCES[1], km, np.random.default_rng(seed + i), turned=False)}))
        for pair in PAIRS
        for km in INTERVAL_KM
        for i in range(lives)
    )
    total = lives * len(PAIRS) * len(INTERVAL_KM)
    yield BenchRow("wheelsets that were not turned, by 0.3 mm", f"{wrong} of {total} found", "none", wrong == 0)


def _found(seen: list[Observation]) -> bool:
    event = identity_events({"W": seen}).get("W")
    return event is not None and event.mistake is Mistake.REVERSED and event.after_ns == seen[BEFORE].from_ns


@cache
def curve(wheel: str, rail: str, inclination: int, centre: float, half_width: float, difference: float) -> FloatArray:
    """Return R (b,) of a hollow wheel on the right and a hollower one on the left, m."""
    right = TreadWear(HOLLOW, centre, half_width, HOLLOW)
    left = TreadWear(HOLLOW + difference, centre, half_width, HOLLOW + difference)
    wheels, rails = wheel_profile(wheel), rail_profile(rail)
    on_track = WheelsetOnTrack(worn(wheels, left), worn(wheels, right), rails, rails, 1.0 / inclination, 1.435)
    table = contact_table(on_track, DISPLACEMENT, (0.0,), method=ContactMethod.EN15302, outside="hold")
    found = np.interp(AT, DISPLACEMENT, table.rolling_radius_difference[:, 0])
    return np.asarray(found - np.interp(0.0, AT, found))


def _even(values: FloatArray) -> FloatArray:
    even = 0.5 * (values + values[::-1])[AT > 0.0]
    return np.asarray(even - even.mean())


def _life(
    pair: tuple[str, str, int, float, float],
    difference: float,
    km: float,
    rng: np.random.Generator,
    *,
    turned: bool = True,
) -> list[Observation]:
    plain = curve(*pair, difference)
    scale = 1.0 + COMMON * rng.standard_normal() / 0.3
    track = TRACK * rng.standard_normal() * np.cos(AT / 1e-3) + TRACK * rng.standard_normal() * np.sin(AT / 1e-3)
    width = round(km / 1.2e5 * YEAR_NS)
    seen = []
    for i in range(BEFORE + BEHIND):
        shape = -plain[::-1] if turned and i >= BEFORE else plain
        noise = 2.0 * AT * NOISE * rng.standard_normal() + 3e-6 * rng.standard_normal(len(AT))
        value = scale * shape * (1.0 + WEAR_PER_KM * km * i) + track + noise
        std = np.hypot(2.0 * np.abs(AT) * np.hypot(COMMON, NOISE), TRACK)
        begin = BEGIN_NS + i * width
        seen.append(
            Observation(
                "W",
                begin,
                begin + width // 2,
                km * (i + 0.5),
                made_geometry(EDGES, BinValues(value, std, (BinStatus.ESTIMATED,) * len(AT)), np.array([3e-3])),
            )
        )
    return seen


VEHICLES, DAYS_APART = 5, 3.0
FINDINGS_BEFORE = (6, 12, 30)  # findings before the change
FINDINGS_BEHIND = 20  # findings
SHARE_LEFT = 0.8  # of the stiffness
OWN_STD, RATIO_STD = 0.03, 0.03  # of the creep of a vehicle's own wheels, and of a finding


def suspension_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield when a spring that is 20 % softer is found, and how long after."""
    found, lasting, wrong, years = [], [], 0, 0.0
    for number, history in enumerate(FINDINGS_BEFORE):
        for i in range(max(1, lives // len(FINDINGS_BEFORE))):
            findings = fleet(history, seed + 100 * number + i)
            histories = suspension_histories(findings)
            breaches = {code: _breaches(code, list(histories[code])) for code in ("V0", "V1")}
            first = len(breaches["V0"]) - FINDINGS_BEHIND
            behind = [is_found for is_found, _ in breaches["V0"][max(0, first) :]]
            after = next((k for k, one in enumerate(behind) if one), None)
            found.append(999 if after is None else after + 1 - min(0, first))
            lasting.append(breaches["V0"][-1][0])
            wrong += any(one for one, _ in breaches["V1"])
            years += (history + FINDINGS_BEHIND) * DAYS_APART / 365.25
    late = np.array(found)
    text = f"{np.mean(late <= 4):.0%} within 4 findings, median {np.median(late):.0f}; {len(late)} fleets"
    yield BenchRow("spring 20 % softer, among 5 vehicles", text, "90 % within 4", float(np.mean(late <= 4)) >= 0.9)
    text = f"{np.mean(lasting):.0%} still found {FINDINGS_BEHIND} findings later"
    yield BenchRow("the same", text, "95 %", float(np.mean(lasting)) >= 0.95)
    text = f"{wrong} in {years:.0f} vehicle-years"
    yield BenchRow("right springs beside it that are found changed", text, "at most 0.02 a year", wrong / years <= 0.02)


def _breaches(code: str, changes: list[object]) -> list[tuple[bool, int]]:
    rule = SuspensionChangeRule()
    newest_first = [suspension_change_finding(rule, code, change) for change in changes]  # type: ignore[arg-type]
    return [(bool(one.breached), one.measured_ns) for one in reversed(newest_first)]


def fleet(history: int, seed: int) -> list[SuspensionFinding]:
    """Return the findings of a fleet on one section, of which the first vehicle softens at once."""
    rng = np.random.default_rng(seed)
    k = history + FINDINGS_BEHIND
    weather = np.zeros(k)
    for i in range(1, k):
        weather[i] = 0.7 * weather[i - 1] + 0.1 * rng.standard_normal()
    found = []
    for v in range(VEHICLES):
        for i in range(k):
            left = SHARE_LEFT if v == 0 and i >= history else 1.0
            noise = np.hypot(OWN_STD, RATIO_STD) * rng.standard_normal()
            begin = BEGIN_NS + round(i * DAYS_APART * DAY_NS) + v * HOUR_NS
            ratio = left * float(np.exp(weather[i] + noise))
            found.append(
                SuspensionFinding(f"V{v}", "S", begin, begin + HOUR_NS, ratio, RATIO_STD * ratio, 0.34, "v", 1)
            )
    return found
