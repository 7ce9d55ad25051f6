"""The scheduled jobs, once, now, in order, under a progress bar."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import typer
from rich.console import Console
from rich.progress import TaskID
from rich.table import Table

from api import logs
from api.factory import open_store, process_name
from api.logs import start_tracing
from api.pipeline import job_context, scheduled_jobs
from api.schemas.windows import SHOWN, WindowReasons, together
from api.settings import Settings
from api.terminal.processes import executor_of
from api.terminal.progress import bar
from api.terminal.stopping import stop_on_signals
from api.times import to_rfc3339
from estimation.errors import ParameterError
from estimation.jobs.estimate_windows import REFUSED, refusals
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.alerts import WorklistRow
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from estimation.values.windows import WindowsOfReason, WithoutEstimate
from estimation.worklist.row import WITHOUT_GEOMETRY
from fleet_db.packed_values import from_document
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.window_counts import COUNTED
from fleet_db.stores.worklist import WorklistFilter

READ = 200_000  # windows that are looked at for all wheelsets together

FEWEST = 20
NAMED = 8  # reasons of all wheelsets together that are printed


@dataclass(frozen=True, slots=True)
class Unestimated:
    """A mounted wheelset without an estimate."""

    row: WorklistRow
    why: WithoutEstimate


@dataclass(frozen=True, slots=True)
class FleetReasons:
    """Why wheelsets have no estimate."""

    mounted: int  # wheelsets that run under a vehicle
    most: int  # newest windows of each that were looked at, at most
    wheelsets: tuple[Unestimated, ...]  # by serial


def fleet_reasons(unit: SqlUnitOfWork) -> FleetReasons:
    """Return why mounted wheelsets have no estimate."""
    rows = [from_document(document) for document in unit.worklist.documents(WorklistFilter())]
    mounted = [row for row in rows if row.wheelset.mounting is not None]
    without = [row for row in mounted if row.state.status is Status.UNESTIMATED]
    most = min(COUNTED, max(FEWEST, READ // max(1, len(without))))
    reasons = WindowReasons(unit)
    return FleetReasons(len(mounted), most, tuple(Unestimated(row, _why(reasons, row, most)) for row in without))


def _why(reasons: WindowReasons, row: WorklistRow, most: int) -> WithoutEstimate:
    """Return why a wheelset has no conicity at 3 mm: what its geometry says, or where it has none its windows."""
    reason = row.state.conicity.reason
    if reason is None or reason.code in WITHOUT_GEOMETRY:
        return reasons.without_estimate(row.wheelset.serial, most=most)
    return WithoutEstimate(reason, reason.code.remedy, (), None, row.state.last_data_ns)


def print_each(settings: Settings) -> None:
    """Print of every mounted wheelset without an estimate why it has none, and what to do."""
    with closing(open_store(settings)) as storage, storage.read() as unit:
        reasons = fleet_reasons(unit)
    for line in summary_lines(reasons) or ["every mounted wheelset has a conicity at 3 mm"]:
        typer.echo(line)
    if reasons.wheelsets:
        table = Table("wheelset", "runs under", "windows", "last data", "why", "what to do")
        for item in reasons.wheelsets:
            why, wheelset = item.why, item.row.wheelset
            shown = [f"{windows.windows} {windows.state.value}: {windows.reason}" for windows in why.windows[:SHOWN]]
            table.add_row(
                wheelset.serial,
                "" if wheelset.mounting is None else f"{wheelset.mounting.vehicle}, axle {wheelset.mounting.axle}",
                str(why.counted),
                "never" if why.last_ns is None else to_rfc3339(why.last_ns),
                "\n".join(shown) or why.reason.text,
                why.what_to_do,
            )
        Console().print(table)


def summary_lines(reasons: FleetReasons) -> list[str]:
    """Return why wheelsets have no estimate, all together: a line a reason; none where all have one."""
    if not reasons.wheelsets:
        return []
    head = f"{len(reasons.wheelsets)} of {reasons.mounted} mounted wheelsets have no conicity at 3 mm"
    windows = together(windows for item in reasons.wheelsets for windows in item.why.windows)
    lines = [f"{head}; their newest windows, at most {reasons.most:,} of each:" if windows else f"{head}:"]
    lines += [f"  {line_of(counted)}" for counted in windows[:NAMED]]
    return lines + [f"  {line}" for line in _without_windows(reasons.wheelsets)]


def _without_windows(wheelsets: Iterable[Unestimated]) -> list[str]:
    """Return a line for those wheelsets, of which no window says why, for which there is the same to do."""
    alike: dict[tuple[ReasonCode, str], list[Unestimated]] = {}
    for item in wheelsets:
        if not item.why.windows:
            alike.setdefault((item.why.reason.code, item.why.what_to_do), []).append(item)
    lines = []
    for (code, to_do), items in sorted(alike.items(), key=lambda pair: -len(pair[1]))[:NAMED]:
        what = "without a window" if code in WITHOUT_GEOMETRY else code.value
        lines.append(
            f"{len(items)} {what}, such as {items[0].row.wheelset.serial}: {items[0].why.reason}. {to_do}".rstrip()
        )
    return lines


def line_of(windows: WindowsOfReason) -> str:
    """Return windows of one reason as a line: how many, why, and what to do."""
    code = "" if windows.reason is None else f" {windows.reason.code.value}: {windows.reason}"
    remedy = "" if windows.reason is None or not windows.reason.code.remedy else f". {windows.reason.code.remedy}"
    return f"{windows.windows} {windows.state.value}{code}{remedy}"


def run_jobs_once(name: str | None, settings: Settings) -> bool:
    """Run every job, or one, print what the runs did, and return whether all succeeded."""
    logs.configure(settings)
    start_tracing()
    scheduled = scheduled_jobs(settings)
    jobs = [job for job in scheduled if name in {None, job.name}]
    if not jobs:
        names = ", ".join(job.name for job in scheduled)
        raise ParameterError(f"no job {name!r}; there are {names}", field="--job")
    console = Console(stderr=True)
    stopping = threading.Event()
    stop_on_signals(stopping)
    with closing(open_store(settings)) as storage, executor_of(settings) as executor:
        context = replace(job_context(settings, storage), stopping=stopping.is_set, executor=executor)
        with storage.owned(JobTrigger.CLI, process_name(), context.lease_s) as owned:
            runs = run_in_order(jobs, replace(context, storage=owned), console)
        Console().print(summary(runs))
        for unfit in executor.unfit if executor is not None else ():
            typer.echo(f"left out: {unfit}")
        with storage.read() as unit:
            without = summary_lines(fleet_reasons(unit))
    for line in without:
        typer.echo(line)
    return all(run.outcome is JobOutcome.SUCCEEDED for run in runs)


def run_in_order(
    jobs: Sequence[Job], context: JobContext, console: Console, trigger: JobTrigger = JobTrigger.CLI
) -> list[JobRun]:
    """Run the jobs one after the other, with a line of progress each; return their records."""
    runs = []
    with bar(console) as progress:
        for job in jobs:
            task = progress.add_task(job.description, total=None)

            def show(done: int, total: int, task: TaskID = task) -> None:
                progress.update(task, completed=done, total=total)

            run = run_job(job, replace(context, progress=show), trigger)
            runs.append(run)
            progress.update(task, total=1, completed=1)
            if run.outcome is JobOutcome.ABANDONED:
                break
    return runs


def summary(runs: Sequence[JobRun]) -> Table:
    """Return what the jobs did, as a table."""
    table = Table("job", "outcome", "seconds", "what it did")
    for run in runs:
        seconds = "" if run.finished_ns is None else f"{(run.finished_ns - run.started_ns) / 1e9:.1f}"
        table.add_row(run.job, run.outcome, seconds, run.error or _counts(run.counts))
    return table


def _counts(counts: Mapping[str, int]) -> str:
    why = ", ".join(f"{count} {code.value}" for code, count in refusals(counts).items())
    named = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if not name.startswith(REFUSED)]
    return ", ".join(f"{count}: {why}" if why and count.endswith(" refused") else count for count in named)
