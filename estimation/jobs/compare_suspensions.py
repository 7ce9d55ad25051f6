"""Stage: has the suspension of a vehicle changed, against its own past and the others on the same sections?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from estimation.alerts.rules.running_gear import SuspensionChangeRule, suspension_change_finding
from estimation.alerts.rules.standing import latest_run, raised_at
from estimation.jobs.job import JobContext
from estimation.jobs.made_from import made_from
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.storage import UnitOfWork
from estimation.trend.suspension import SuspensionParameters, suspension_histories
from estimation.values.alerts import Finding
from estimation.values.results import EVERYTHING, Facet
from estimation.values.trend import SUSPENSION, SuspensionChange, SuspensionFinding, SuspensionShown


@dataclass(frozen=True, slots=True)
class SuspensionInputs:
    """The newest findings of all vehicles, and by vehicle the rule of its fleet and class.

    Attributes:
        parameters: What counts as now and what friction may do, the same for all.
    """

    findings: tuple[SuspensionFinding, ...]
    rules: Mapping[str, SuspensionChangeRule]
    parameters: SuspensionParameters


def load(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, SuspensionInputs]:
    """Return what is known of all vehicles."""
    book = context.settings.rules
    parameters = book.rule(SuspensionChangeRule).parameters
    rules = {
        vehicle.code: book.of(vehicle.fleet, vehicle.vehicle_class).rule(SuspensionChangeRule)
        for vehicle in unit.registry.vehicles()
    }
    findings = tuple(unit.suspensions.newest(parameters.recent + parameters.most_past))
    return {EVERYTHING: SuspensionInputs(findings, rules, parameters)}


def compute(inputs: SuspensionInputs) -> Outcome[SuspensionShown]:
    """Return what is shown of every vehicle on file."""
    histories = suspension_histories(inputs.findings, inputs.parameters)
    shown = {code: _shown(rule, code, histories.get(code, iter(()))) for code, rule in inputs.rules.items()}
    # findings of others on its sections count as far as they change what is shown
    return Outcome([Part(one, subject=code, made_from=made_from(one)) for code, one in shown.items()])


def _shown(rule: SuspensionChangeRule, vehicle: str, history: Iterator[SuspensionChange]) -> SuspensionShown:
    read: list[SuspensionChange] = []

    def newest_first() -> Iterator[Finding]:
        for change in history:
            read.append(change)
            yield suspension_change_finding(rule, vehicle, change)

    if not latest_run(newest_first(), rule.delays):
        return SuspensionShown(read[0] if read else None, stands=False)
    read += history
    findings = (suspension_change_finding(rule, vehicle, change) for change in reversed(read))
    return SuspensionShown(read[0], stands=True, since_ns=raised_at(findings, rule.delays))


SUSPENSIONS = Stage(
    name=SUSPENSION.stage,
    job="evaluate_alerts",
    kind=SUSPENSION.subject,
    facets=(Facet.REGISTRY, Facet.STIFFNESS),
    settings=lambda settings: settings.rules.version,
    load=load,
    compute=compute,
    counted=Counted(looked="looked_at", changed="changed"),
    results=SUSPENSION,
    together=True,
)
