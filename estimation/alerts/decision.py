"""Whether an alert says another thing than the feed contained last: something to decide by.

That is its severity, condition, action, limits or acknowledgement; the urgency of its wheelset; a code or a word of its
evidence; the band of its probability; the date of the limit; and a number that left the interval that was published.
What was published last is kept beside the delays of the alert, so that what creeps is published in the end.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping

from estimation.alerts.parameters import FINDINGS
from estimation.trend.now import SCALE
from estimation.values.alerts import Alert
from estimation.values.fields import JsonValue

SAID = ("reason", "unknown_because")  # sentences: codes and numbers say it already
NEWEST = ("from_ns", "to_ns", "last_usable_ns")  # of the data, which go on
NOW = ("distance_to_limit_km", "probability_over_limit")  # change with every kilometre; the date does not
DATE, DELAYS, PUBLISHED = "date_of_limit_ns", "delays", "published"
QUANTILES = ("p10", "p50", "p90")


def snapshot(alert: Alert) -> dict[str, JsonValue]:
    """Return what a reader gets of numbers and dates."""
    return {
        "probability": alert.probability,
        "at_ns": alert.last_seen_ns,
        "evidence": {key: value for key, value in alert.evidence.items() if key != DELAYS and key not in NOW},
    }


def published_of(alert: Alert) -> Mapping[str, JsonValue]:
    """Return what was published of an alert last; as it is, where nobody noted that."""
    delays = alert.evidence.get(DELAYS)
    published = delays.get(PUBLISHED) if isinstance(delays, dict) else None
    return published if isinstance(published, dict) else snapshot(alert)


def differs(published: Mapping[str, JsonValue], before: Alert, after: Alert) -> bool:
    """Return whether an alert says another thing than before, and than what was published last."""
    if _plain(before) != _plain(after) or _in_band(published.get("probability"), after.probability):
        return True
    was, now = published.get("evidence"), snapshot(after)["evidence"]
    if not isinstance(was, dict) or not isinstance(now, dict):
        return True
    exact = after.wheelset is None and after.track_section is None  # of a fleet: how many members
    at_ns = published.get("at_ns")
    times = at_ns if isinstance(at_ns, int) else after.last_seen_ns, after.last_seen_ns
    if _date_moved(was.get(DATE), now.get(DATE), times):
        return True
    pairs = dict(_leaves("", was)), dict(_leaves("", now))
    if pairs[0].keys() != pairs[1].keys():
        return True
    return any(_moved(name, leaf, pairs[1][name], exact=exact) for name, leaf in pairs[0].items())


def _plain(alert: Alert) -> tuple[object, ...]:
    over = alert.evidence.get("probability_over_limit")
    urgency = SCALE.over(over if isinstance(over, (int, float)) else 0.0)
    limits = (alert.raise_limit, alert.clear_limit)
    return alert.severity, alert.condition, urgency, alert.action, limits, alert.acknowledged_by


def _in_band(was: JsonValue, now: float | None) -> bool:
    """Return whether a probability is in another band, and not only just."""
    if not isinstance(was, (int, float)) or now is None:
        return (was is None) != (now is None)
    bands = (bisect_right(FINDINGS.probability_bands, probability) for probability in (was, now))
    return len(set(bands)) > 1 and abs(_log_odds(now) - _log_odds(was)) > FINDINGS.band_log_odds


def _log_odds(probability: float) -> float:
    held = min(max(probability, FINDINGS.least_probability), 1.0 - FINDINGS.least_probability)
    return math.log(held / (1.0 - held))


def _date_moved(was: JsonValue, now: JsonValue, times: tuple[int, int]) -> bool:
    """Return whether the date of the limit left the interval that was published, or a share of what was left then.

    ``times`` are those of the data then and now: a limit that is as good as reached has no date to plan by.
    """
    if not isinstance(was, dict) or not isinstance(now, dict):
        return isinstance(was, dict) != isinstance(now, dict)
    low, middle, high = (_beyond_if_none(was.get(name)) for name in QUANTILES)
    date = _beyond_if_none(now.get("p50"))
    if math.isinf(date) and math.isinf(middle):
        return False
    left = max(middle - times[0], 0.0)
    reached = left <= FINDINGS.least_shift_ns and date - times[1] <= FINDINGS.least_shift_ns
    if reached or abs(date - middle) <= FINDINGS.least_shift_ns:
        return False
    return not low <= date <= high or abs(date - middle) > FINDINGS.date_share * left


def _beyond_if_none(date: JsonValue) -> float:
    return float(date) if isinstance(date, (int, float)) else math.inf


def _leaves(name: str, value: JsonValue) -> Iterator[tuple[str, JsonValue]]:
    """Yield estimates, and what else is no mapping or list, under their names."""
    if isinstance(value, dict) and "interval_95" not in value:
        for key, item in value.items():
            if key not in (*SAID, *NEWEST, DATE):
                yield from _leaves(f"{name}.{key}", item)
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _leaves(f"{name}.{number}", item)
    else:
        yield name, value


def _moved(name: str, was: JsonValue, now: JsonValue, *, exact: bool) -> bool:
    if isinstance(was, dict) and isinstance(now, dict):
        value, interval = now.get("value"), was.get("interval_95")
        same = all(was.get(key) == now.get(key) for key in ("status", "reason_code"))
        if not same or not isinstance(value, (int, float)) or not isinstance(interval, list):
            return not same or (was.get("value") is None) != (value is None)
        low, high = (_beyond_if_none(end) for end in interval)
        return not low <= value <= high
    numbers = [one for one in (was, now) if isinstance(one, (int, float)) and not isinstance(one, bool)]
    if exact or name.endswith("_ns") or len(numbers) < 2:  # noqa: PLR2004 - one of them is no number
        return was != now
    return abs(numbers[1] - numbers[0]) > FINDINGS.number_share * abs(numbers[0])
