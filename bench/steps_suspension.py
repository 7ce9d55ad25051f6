"""Springs that soften at once: when the rule finds them, whether the finding lasts, and how often it is wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.report import BenchRow
from bench.steps_lives import BEGIN_NS
from estimation.alerts.rules.running_gear import SuspensionChangeRule, suspension_change_finding
from estimation.trend.suspension import suspension_histories
from estimation.values.trend import SuspensionFinding
from estimation.values.units import DAY_NS

VEHICLES, DAYS_APART = 5, 3.0
HISTORIES = (6, 12, 30)  # findings before the change
BEHIND = 20  # findings
SHARE_LEFT = 0.8  # of the stiffness
OWN_STD, RATIO_STD = 0.03, 0.03  # of the creep of a vehicle's own wheels, and of a finding


def suspension_rows(seed: int, lives: int) -> Iterator[BenchRow]:
    """Yield when a spring that is 20 % softer is found, and how long after."""
    found, lasting, wrong, years = [], [], 0, 0.0
    for number, history in enumerate(HISTORIES):
        for i in range(max(1, lives // len(HISTORIES))):
            findings = fleet(history, seed + 100 * number + i)
            histories = suspension_histories(findings)
            breaches = {code: _findings(code, list(histories[code])) for code in ("V0", "V1")}
            first = history - _before_first(breaches["V0"], history + BEHIND)
            behind = [is_found for is_found, _ in breaches["V0"][max(0, first) :]]
            after = next((k for k, one in enumerate(behind) if one), None)
            found.append(999 if after is None else after + 1 - min(0, first))
            lasting.append(breaches["V0"][-1][0])
            wrong += any(one for one, _ in breaches["V1"])
            years += (history + BEHIND) * DAYS_APART / 365.25
    late = np.array(found)
    text = f"{np.mean(late <= 4):.0%} within 4 findings, median {np.median(late):.0f}; {len(late)} fleets"
    yield BenchRow("spring 20 % softer, among 5 vehicles", text, "90 % within 4", float(np.mean(late <= 4)) >= 0.9)
    text = f"{np.mean(lasting):.0%} still found {BEHIND} findings later"
    yield BenchRow("the same", text, "95 %", float(np.mean(lasting)) >= 0.95)
    text = f"{wrong} in {years:.0f} vehicle-years"
    yield BenchRow("right springs beside it that are found changed", text, "at most 0.02 a year", wrong / years <= 0.02)


def _before_first(breaches: list[tuple[bool, int]], findings: int) -> int:
    return findings - len(breaches)


def _findings(code: str, changes: list[object]) -> list[tuple[bool, int]]:
    rule = SuspensionChangeRule()
    newest_first = [suspension_change_finding(rule, code, change) for change in changes]  # type: ignore[arg-type]
    return [(bool(one.breached), one.measured_ns) for one in reversed(newest_first)]


def fleet(history: int, seed: int) -> list[SuspensionFinding]:
    """Return the findings of a fleet on one section, of which the first vehicle softens at once.

    Args:
        history: Findings before that.
    """
    rng = np.random.default_rng(seed)
    k = history + BEHIND
    weather = np.zeros(k)
    for i in range(1, k):
        weather[i] = 0.7 * weather[i - 1] + 0.1 * rng.standard_normal()
    found = []
    for v in range(VEHICLES):
        for i in range(k):
            left = SHARE_LEFT if v == 0 and i >= history else 1.0
            noise = np.hypot(OWN_STD, RATIO_STD) * rng.standard_normal()
            begin = BEGIN_NS + round(i * DAYS_APART * DAY_NS) + v * 3600 * 10**9
            ratio = left * float(np.exp(weather[i] + noise))
            found.append(
                SuspensionFinding(f"V{v}", "S", begin, begin + 3600 * 10**9, ratio, RATIO_STD * ratio, 0.34, "v", 1)
            )
    return found
