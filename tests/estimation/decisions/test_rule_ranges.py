"""What an operator may set: every number of every rule at the ends of its range, and just beyond them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import get_args, get_origin, get_type_hints

import pytest

from api.rules_file import load_rules
from estimation.alerts.rule_book import ALERT_RULES, AlarmFloodRule, RuleBook
from estimation.errors import InputError


@dataclass(frozen=True)
class Range:
    """The least and the greatest value that may be set; ``text`` writes a value as a file."""

    least: float
    most: float
    whole: bool = False

    def accepted(self) -> list[float]:
        return [self.least, 1e12 if math.isinf(self.most) else self.most]

    def refused(self) -> list[float]:
        if self.whole:
            return [self.least - 1, self.most + 1]
        ends = [math.nextafter(self.least, -math.inf)]
        return ends if math.isinf(self.most) else [*ends, math.nextafter(self.most, math.inf)]


NUMBER = Range(0.0, 1e9)
COUNT = Range(0, 1_000_000_000, whole=True)
PROBABILITY = Range(0.5, 0.9999)
SHARE = Range(0.0, 1.0)
WINDOWS = Range(1, 1_000_000, whole=True)
DELAYS = {
    "delays.on_evaluations": Range(1, 1000, whole=True),
    "delays.off_evaluations": Range(1, 1000, whole=True),
    "delays.acknowledgement_days": Range(0.01, 3650.0),
    "delays.on_delay_km": Range(0.0, 100_000.0),
    "delays.off_delay_km": Range(0.0, 100_000.0),
}
RANGES: dict[str, dict[str, Range]] = {
    "conicity_limit": {
        **DELAYS,
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "clear_margin": NUMBER,
        "minimum_windows": WINDOWS,
        "bands.limit": Range(0.001, 2.0),
        "bands.up_to_km_h": Range(1.0, math.inf),
        "bands.per_km_h": Range(-1.0, 1.0),
    },
    "limit_forecast": {
        **DELAYS,
        "within_km": NUMBER,
        "clear_within_km": NUMBER,
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "minimum_points": Range(2, 1_000_000, whole=True),
    },
    "wheel_asymmetry": {
        **DELAYS,
        "offset_limit_mm": NUMBER,
        "offset_clear_mm": NUMBER,
        "shape_limit_mm": NUMBER,
        "shape_clear_mm": NUMBER,
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "minimum_windows": WINDOWS,
    },
    "no_data": {**DELAYS, "days": Range(0.01, 3650.0), "critical_days": NUMBER},
    "sensor_fault": {
        **DELAYS,
        "latest_windows": Range(1, 1000, whole=True),
        "minimum_windows": WINDOWS,
        "raise_share": SHARE,
        "clear_share": SHARE,
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "clipped_share": SHARE,
        "invalid_share": SHARE,
    },
    "identity": {
        **DELAYS,
        **{
            f"parameters.{name}": NUMBER
            for name in (
                "trusted_std", "floor", "relative", "level", "wear_per_1000_km", "uneven",
                "least_jump", "most_left", "least_gain", "reach",
            )
        },
        "parameters.least_bins": COUNT,
        "parameters.least_windows": COUNT,
    },
    "hunting": {
        **DELAYS,
        "latest_windows": Range(1, 1000, whole=True),
        "raise_windows": WINDOWS,
        "critical_windows": WINDOWS,
        "minimum_windows": WINDOWS,
        "hunting_share": SHARE,
    },
    "suspension_change": {
        **DELAYS,
        "raise_change": Range(0.01, 10.0),
        "raise_step": Range(0.01, 10.0),
        "clear_change": Range(0.01, 10.0),
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "parameters.recent": Range(1, 1000, whole=True),
        "parameters.least_past": Range(1, 1000, whole=True),
        "parameters.most_past": Range(1, 1000, whole=True),
        "parameters.together_days": Range(0.01, 365.0),
        "parameters.common_creep_std": Range(0.001, 1.0),
        "parameters.own_creep_std": Range(0.001, 1.0),
    },
    "data_quality": {
        **DELAYS,
        "latest_windows": Range(1, 1000, whole=True),
        "raise_windows": WINDOWS,
        "minimum_windows": WINDOWS,
    },
    "low_adhesion": {
        **DELAYS,
        "raise_friction": Range(0.02, 0.6),
        "raise_probability": PROBABILITY,
        "pooled_hours": Range(0.1, 720.0),
    },
    "measure": {
        **DELAYS,
        "raise_probability": Range(0.01, 0.9),
        "extrapolated_probability": Range(0.01, 0.9),
        "clear_probability": Range(0.01, 0.9),
        "reaches": Range(1.0, 10.0),
        "measured_within_km": Range(0.0, 100_000.0),
    },
    "weak_damper": {
        **DELAYS,
        "raise_share": Range(0.05, 1.5),
        "clear_share": Range(0.05, 1.5),
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "minimum_windows": WINDOWS,
    },
    "unregistered_change": {
        **DELAYS,
        "warning_fall": Range(0.0, 2.0),
        "critical_rise": Range(0.0, 2.0),
    },
    "wheel_flat": {
        **DELAYS,
        "latest_windows": Range(1, 1000, whole=True),
        "minimum_windows": WINDOWS,
        "raise_share": SHARE,
        "clear_share": SHARE,
        "raise_probability": PROBABILITY,
        "clear_probability": PROBABILITY,
        "critical_m_s2": NUMBER,
    },
    "alarm_flood": {"more_than": WINDOWS, "within_hours": Range(0.01, 87_600.0)},
}  # fmt: skip


def numbers_of(value_type: type, prefix: str = "") -> Iterator[str]:
    """Yield the names of the numbers that a rule has, also those in its parts."""
    hints = get_type_hints(value_type)
    for item in fields(value_type):
        hint, name = hints[item.name], f"{prefix}{item.name}"
        element = get_args(hint)[0] if get_origin(hint) is tuple else hint
        if is_dataclass(element):
            yield from numbers_of(element, f"{name}.")
        elif element in (int, float):
            yield name


def test_every_number_of_every_rule_has_its_range_here() -> None:
    tables = {rule.kind: rule for rule in ALERT_RULES} | {"alarm_flood": AlarmFloodRule}
    assert {kind: set(numbers_of(rule)) for kind, rule in tables.items()} == {
        kind: set(ranges) for kind, ranges in RANGES.items()
    }


def refused_as_outside(file: Path, kind: str, name: str, value: float) -> bool:
    """Write one number into a rules file; return whether it is refused as outside its range."""
    parent, _, key = name.rpartition(".")
    header = f"[[{kind}.{parent}]]\n" if parent == "bands" else f"[{kind}{'.' * bool(parent)}{parent}]\n"
    needed = "limit = 0.3\n" if parent == "bands" and key != "limit" else ""
    file.write_text(f"{header}{needed}{key} = {value!r}\n", encoding="utf-8")
    try:
        load_rules(file, RuleBook(tuple(rule() for rule in ALERT_RULES if rule.kind == kind)))
    except InputError as error:
        field = f"{kind}.{name}".replace("bands.", "bands[0].")
        return error.field == field and "outside" in str(error)
    return False


@pytest.mark.parametrize("kind", RANGES)
def test_a_number_may_be_set_to_the_ends_of_its_range_and_not_beyond(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "rules.toml"
    outside = {
        (name, value): refused_as_outside(file, kind, name, value)
        for name, allowed in RANGES[kind].items()
        for value in (*allowed.accepted(), *allowed.refused())
    }
    assert outside == {
        (name, value): value in allowed.refused()
        for name, allowed in RANGES[kind].items()
        for value in (*allowed.accepted(), *allowed.refused())
    }
