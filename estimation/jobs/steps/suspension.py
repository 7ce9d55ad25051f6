"""What an epoch shows of the suspension of vehicles, into the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from estimation.jobs.job import JobContext
from estimation.storage import UnitOfWork
from estimation.track.panel.instrumental_slope import PRIOR_STD
from estimation.track.update import AlignmentUpdate
from estimation.values.track import TrackEpoch
from estimation.values.trend import SuspensionFinding
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
