"""When time alone changes what the alert rules find."""

from __future__ import annotations

from estimation.alerts.life_cycle import DAY_NS, acknowledgement_ends_ns
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.no_data import NoDataRule, silent_since_ns
from estimation.alerts.rules.rule import WheelsetFacts


def next_change_ns(facts: WheelsetFacts, book: RuleBook, now_ns: int) -> int | None:
    """Return when the same facts may first say something else, ns UTC; None where time alone changes nothing.

    Time counts where a wheelset is silent, and where an acknowledgement runs out.
    """
    moments = [ends for alert in facts.open_alerts if (ends := acknowledgement_ends_ns(alert)) is not None]
    if facts.wheelset.mounting is not None:
        silent, since_ns = book.rule(NoDataRule), silent_since_ns(facts.last_usable_ns, facts.wheelset.mounting.from_ns)
        moments += [since_ns + round(days * DAY_NS) for days in (silent.days, silent.critical_days)]
    return min((at for at in moments if at >= now_ns), default=None)
