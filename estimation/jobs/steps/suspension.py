"""What an epoch shows of the suspension of vehicles, into the store; and which of them have changed, out of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.standing import latest_run, raised_at
from estimation.alerts.rules.suspension_change import SuspensionChangeRule, suspension_change_finding
from estimation.jobs.job import JobContext
from estimation.jobs.steps.roster import Roster
from estimation.storage import UnitOfWork
from estimation.track.panel.stiffness_ratio import PRIOR_STD
from estimation.track.update import AlignmentUpdate
from estimation.trend.suspension import suspension_histories
from estimation.values.alerts import Finding
from estimation.values.track import TrackEpoch
from estimation.values.trend import SuspensionChange, SuspensionFinding, SuspensionShown
from estimation.values.windows import WindowRecord
from estimation.vehicle.vehicle_class import ClassOnFile

LEARNT = 0.7  # of the std beforehand: with more, the passes say nothing of the ratio


def store_suspension(
    unit: UnitOfWork,
    epoch: TrackEpoch,
    records: Sequence[WindowRecord],
    update: AlignmentUpdate,
    classes: Mapping[str, ClassOnFile],
    context: JobContext,
) -> int:
    """Store the stiffness ratio of every vehicle that the epoch shows; return of how many."""
    iterated = update.estimate.iterated
    if iterated is None or not update.estimate.report.converged or update.outcome.windows_wait:
        return 0
    known = 0
    for code, ratio in sorted(iterated.ratios.items()):
        own = [record for record in records if record.vehicle == code]
        if not own or code not in classes or not 0.0 < ratio.std <= LEARNT * PRIOR_STD:
            continue
        vehicle = classes[code].vehicle_class.parameters
        unit.suspensions.put(
            SuspensionFinding(
                vehicle=code,
                section=epoch.section,
                from_ns=min(record.start_ns for record in own),
                to_ns=max(record.start_ns + record.length_ns for record in own),
                ratio=ratio.value,
                ratio_std=ratio.std,
                assumed=vehicle.yaw_stiffness / vehicle.longitudinal_creep_coefficient,
                code_version=context.code_version,
                recorded_ns=context.clock.now_ns(),
            ),
            epoch.number,
        )
        known += 1
    return known


def shown_by_wheelset(unit: UnitOfWork, on_file: Roster, book: RuleBook) -> Mapping[str, SuspensionShown]:
    """Return what is shown of all vehicles, each at the wheelset of the vehicle's first axle that has one.

    Args:
        book: What counts as now and what friction may do, the same for all; what raises and clears, by fleet and class.
    """
    p = book.rule(SuspensionChangeRule).parameters
    histories = suspension_histories(unit.suspensions.newest(p.recent + p.most_past), p)
    mounted = {one.mounting.vehicle for one in on_file.wheelsets if one.mounting is not None}
    known = {code: (code, histories.get(code, iter(()))) for code in mounted}
    shown = {}
    for serial, (code, history) in on_file.at_first_axles(known).items():
        vehicle = on_file.vehicles[code]
        rule = book.of(vehicle.fleet, vehicle.vehicle_class).rule(SuspensionChangeRule)
        shown[serial] = _shown(rule, serial, history)
    return shown


def _shown(rule: SuspensionChangeRule, serial: str, history: Iterator[SuspensionChange]) -> SuspensionShown:
    read: list[SuspensionChange] = []

    def newest_first() -> Iterator[Finding]:
        for change in history:
            read.append(change)
            yield suspension_change_finding(rule, serial, change)

    if not latest_run(newest_first(), rule.delays):
        return SuspensionShown(read[0] if read else None, stands=False)
    read += history
    found = (suspension_change_finding(rule, serial, change) for change in reversed(read))
    return SuspensionShown(read[0], stands=True, since_ns=raised_at(found, rule.delays))
