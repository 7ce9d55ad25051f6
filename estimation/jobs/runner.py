"""What is done for every stage alike: find what is due, claim it, load, compute each alone, store, note what was seen.

What fails at one subject goes to quarantine with its reason and is tried ever more rarely; the others go on. A subject
whose inputs turn out to be the same as before is not computed again: only the mark of the stage advances. Results and
marks are stored in one transaction, so that a process that is killed leaves a subject as it was: due.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import dropwhile, islice

from estimation.errors import ConflictError, StoppedError, TreadwatchError
from estimation.jobs.job import JobContext, Work
from estimation.jobs.parameters import WORK
from estimation.jobs.stage import AnyStage, Outcome, Part, check_finite, made_from
from estimation.jobs.work import Isolation, fails_alone, hand_out, unit_size
from estimation.storage import UnitOfWork
from estimation.values.runs import AnyResult, Due, Look, Mark, Result, StageInputs, SubjectKind

CHANGED = "changed_meanwhile"
"""Counts subjects that have changed between the reading of their inputs and the storing, of stages that name it."""


def run(stage: AnyStage, context: JobContext) -> Mapping[str, int]:
    """Bring the results of a stage up to date; return what was counted. Where nothing is due this is one statement."""
    return run_all((stage,), context)


def run_all(stages: Iterable[AnyStage], context: JobContext, isolation: Isolation | None = None) -> Counter[str]:
    """Bring the results of stages of a job up to date, one after the other; return what was counted of all."""
    waiting = deque(stages)
    counts, listed = Counter(quarantined=0), set[str]()
    isolation, looked = isolation or Isolation(context, waiting[0].job), False
    while waiting:
        if looked and not _is_listed(waiting[0], listed):
            with context.storage.write(fenced=False) as unit:  # whoever lists them, they are due
                unit.marks.list_again(waiting[0].inputs(context))
            listed.add(waiting[0].name)
        due: Mapping[str, Due] = {}
        with context.storage.read() as unit:
            look = None
            if not looked:
                looked, (waiting, look) = True, _not_at_rest(unit, waiting, context, (counts, isolation, listed))
            while waiting and not due and _is_listed(stage := waiting[0], listed):
                waiting.popleft()
                if look is None or stage.kind is SubjectKind.WINDOW:
                    due = unit.marks.due(stage.inputs(context), context.clock.now_ns())
                else:
                    due = look.due.get(stage.name, {})
                _count_due(stage, due, counts)
            if due:
                isolation.read(unit)
                tried = partial(_tried, stage.inputs(context))
                ready = [key for key, seen in due.items() if not isolation.waits(stage.kind, key, partial(tried, seen))]
                working = _Working(stage, context, stage.inputs(context), isolation)
                first = working.read(unit, ready[: stage.batch(context)], due) if stage.here else None
        if due and stage.here:
            counts.update(_done_here(working, ready, len(due), first))
        elif due:
            _try_again(stage, context, ready, isolation)
            counts.update(_handed_out(stage, context, ready, len(due), isolation))
    counts["quarantined"] += isolation.quarantined
    return counts


def run_counted(stages: Iterable[AnyStage], context: JobContext) -> Mapping[str, int]:
    """Bring the results of stages up to date; return what was counted, without the looks at all subjects together."""
    return {name: count for name, count in run_all(stages, context).items() if name != "looks"}


def _is_listed(stage: AnyStage, listed: Collection[str]) -> bool:
    """Return whether a stage that works window by window has listed all of them with these settings."""
    return stage.kind is not SubjectKind.WINDOW or stage.name in listed


def _not_at_rest(
    unit: UnitOfWork, stages: deque[AnyStage], context: JobContext, seen: tuple[Counter[str], Isolation, set[str]]
) -> tuple[deque[AnyStage], Look]:
    """Return the stages from the first on of which something is due, and what is due of each.

    ``seen`` counts all that the stages have seen as at rest, knows what is held, and which windows are listed.
    """
    counts, isolation, listed = seen
    for stage in stages:
        counts.update(dict.fromkeys(stage.counted.names, 0))
    counted = {stage.name: stage for stage in stages if stage.counted.same is not None}
    inputs = [stage.inputs(context) for stage in stages]
    look = unit.marks.look(inputs, context.clock.now_ns(), counted, stages[0].job)
    for name, number in look.seen.items():
        counts.update({counted[name].counted.looked: number, str(counted[name].counted.same): number})
    if not look.held:
        isolation.nothing_held()
    listed |= look.listed
    return deque(dropwhile(lambda stage: stage.name not in look.due, stages)), look


def _count_due(stage: AnyStage, due: Mapping[str, Due], counts: Counter[str]) -> None:
    if stage.counted.same is not None:
        marked = sum(state.marked for state in due.values())
        counts.subtract({stage.counted.looked: marked, stage.counted.same: marked})


def _try_again(stage: AnyStage, context: JobContext, ready: Collection[str], isolation: Isolation) -> None:
    if stage.again is not None and (failed := [item for item in isolation.held(stage.kind) if item.key in set(ready)]):
        with context.storage.write() as unit:
            stage.again(unit, failed)


def work_of(stage: AnyStage, isolation: Isolation | None = None) -> Work:
    """Return the work of a stage in units, as it is handed out to processes."""
    return Work(stage.name, partial(_work, stage, isolation), partial(_set_aside, stage))


def _handed_out(
    stage: AnyStage, context: JobContext, ready: Sequence[str], total: int, isolation: Isolation
) -> Counter[str]:
    # of a large batch by itself: a stop is looked for between units
    batches = 1 if stage.at_once is None else WORK.claimed_batches
    size = unit_size(context, len(ready), batches * stage.batch(context))
    done = total - len(ready)

    def progress(more: int) -> None:
        nonlocal done
        done += more
        context.checkpoint(done, total)

    context.checkpoint(done, total)
    return hand_out(context, work_of(stage, isolation), _batches(ready, size), progress)


def _done_here(working: _Working, ready: Sequence[str], total: int, first: _Read | None) -> Counter[str]:
    """Do what is cheap in this process, without claims: what another one has stored meanwhile is not stored again."""
    done = total - len(ready)
    for batch in _batches(ready, working.stage.batch(working.context)):
        working.context.checkpoint(done, total)
        working.do(batch, first)
        done, first = done + len(batch), None
    working.context.checkpoint(done, total)
    return working.counts


def _work(stage: AnyStage, of_run: Isolation | None, context: JobContext, subjects: Sequence[str]) -> Mapping[str, int]:
    """Do subjects that are claimed, some in a transaction."""
    isolation = Isolation(context, stage.job) if of_run is None else of_run.of_claims(context)
    working = _Working(stage, context, stage.inputs(context), isolation)
    for batch in _batches(subjects, stage.batch(context)):
        working.do(batch)
    working.counts["quarantined"] = working.isolation.quarantined
    return working.counts


def _set_aside(stage: AnyStage, context: JobContext, subject: str, error: TreadwatchError) -> None:
    """Keep a subject in quarantine at which workers have ended."""
    inputs = stage.inputs(context)
    with context.storage.read() as unit:
        due = unit.marks.due(inputs, context.clock.now_ns(), [subject])
    working = _Working(stage, context, inputs, Isolation(context, stage.job))
    working.keep(subject, due.get(subject, Due(0)), error)


_Read = tuple[Mapping[str, Due], Mapping[str, object]]
"""What is due, and its inputs, by subject."""


@dataclass(slots=True)
class _Working:
    """Work of a stage on the subjects of a unit."""

    stage: AnyStage
    context: JobContext
    inputs: StageInputs
    isolation: Isolation
    counts: Counter[str] = field(default_factory=Counter)
    _stored: set[str] = field(default_factory=set)  # subjects of which a part was stored

    def do(self, subjects: Sequence[str], read: _Read | None = None) -> None:
        """Load, compute and store subjects together, and the rest of those of which that was a part each alone."""
        waiting = deque([subjects])
        while waiting:
            rest = self._do(waiting.popleft(), read)
            read = None
            if rest and self.context.stopping is not None and self.context.stopping():
                raise StoppedError(len(self._stored), len(self._stored) + len(rest))
            self._stored.update(rest)
            waiting.extend([subject] for subject in rest)

    def read(self, unit: UnitOfWork, subjects: Sequence[str], due: Mapping[str, Due]) -> _Read | None:
        """Return the inputs of subjects; None where that fails, which it will again by itself."""
        states = {subject: due[subject] for subject in subjects}
        try:
            return states, self._load(unit, states)
        except Exception as error:
            if not fails_alone(error):
                raise
            return None

    def _load(self, unit: UnitOfWork, due: Mapping[str, Due]) -> Mapping[str, object]:
        self.isolation.read(unit)
        if self.stage.kind is SubjectKind.WHEELSET:
            unit.together.update(due)
        return self.stage.load(unit, list(due), self.context) if due else {}

    def _do(self, subjects: Sequence[str], read: _Read | None) -> Sequence[str]:
        """Do subjects together; where that fails, each alone. Return those that are due still.

        Versions are read in the snapshot in which the inputs are: what is committed later leaves a subject due.
        """
        due: Mapping[str, Due] = {}
        try:
            if read is not None:
                due, loaded = read
            else:
                with self.context.storage.read() as unit:
                    due = unit.marks.due(self.inputs, self.context.clock.now_ns(), subjects)
                    loaded = self._load(unit, due)
            made = self._computed(due, loaded)
            return self._store(due, loaded, made)
        except Exception as error:
            if not fails_alone(error):
                raise
            if len(subjects) > 1:
                for subject in subjects:
                    self.do([subject])
            elif not isinstance(error, ConflictError):  # with a conflict it is still due
                self.keep(subjects[0], due.get(subjects[0], Due(0)), error)
            elif CHANGED in self.stage.counted.names:
                self.counts[CHANGED] += 1
        return ()

    def _computed(self, due: Mapping[str, Due], loaded: Mapping[str, object]) -> dict[str, _Made]:
        """Return what was computed of each subject that did not fail; None where its inputs are those of before."""
        made = {}
        for subject, state in due.items():
            try:
                made[subject] = self._one(state, loaded.get(subject))
            except ConflictError:
                continue
            except Exception as error:
                if not fails_alone(error):
                    raise
                self.keep(subject, state, error)
        return made

    def _one(self, state: Due, inputs: object | None) -> _Made:
        """Return what came of a subject; ``compute`` is not called where its inputs are those of before."""
        if inputs is None:
            return _Made("", Outcome())
        digest = made_from(self.context.code_version, self.stage.numbers, inputs)
        if digest == state.made_from:
            return _Made(digest, None)
        outcome = self.stage.compute(inputs)
        for part in outcome.parts:
            check_finite(part)
        return _Made(digest, outcome)

    def _store(self, due: Mapping[str, Due], loaded: Mapping[str, object], made: Mapping[str, _Made]) -> Sequence[str]:
        if not made:
            return ()
        stored: Counter[str] = Counter()
        with self.context.storage.write(fenced=not self.stage.here) as unit:
            if self.stage.here:
                made = self._not_stored_yet(unit, due, made)
            computed = {key: (loaded[key], new.outcome) for key, new in made.items() if new.outcome and key in loaded}
            results = [self._result(subject, item, part) for subject, item in made.items() for part in item.parts]
            changed = self._put(unit, results)
            if self.stage.store is not None and computed:
                stored.update(self.stage.store(unit, self.context, computed))
            whole = {subject: item.mark(due[subject]) for subject, item in made.items() if not item.more}
            unit.marks.note(self.inputs, whole)
            unit.done.update(whole)
        self.counts.update(stored)
        looked = {subject: item for subject, item in made.items() if subject in loaded and not item.more}
        self._count(looked, {result.subject for result in changed}, len(changed))
        for subject, item in made.items():
            self.isolation.release(self.stage.kind, subject)
            if self.stage.together and item.outcome is not None:
                self._keep_failed(item.outcome.failed)
        return sorted(made.keys() - whole.keys())

    def _not_stored_yet(
        self, unit: UnitOfWork, due: Mapping[str, Due], made: Mapping[str, _Made]
    ) -> Mapping[str, _Made]:
        """Return what no other process has done since it was read; nobody else stores of such stages meanwhile."""
        unit.marks.alone()
        now = unit.marks.due(self.inputs, self.context.clock.now_ns(), list(made))
        same = {subject for subject, item in now.items() if item.made_from == due[subject].made_from}
        return {subject: item for subject, item in made.items() if subject in same}

    def _keep_failed(self, failed: Mapping[tuple[SubjectKind, str], Exception]) -> None:
        """Keep what failed alone of a look at all together; what does not any more is released."""
        for item in (quarantined for kind in SubjectKind for quarantined in self.isolation.held(kind)):
            if not item.inputs and (item.kind, item.key) not in failed:
                self.isolation.release(item.kind, item.key)
        for (kind, key), error in failed.items():
            self.isolation.keep(kind, key, "", error)

    def _put(self, unit: UnitOfWork, results: Sequence[AnyResult]) -> Sequence[AnyResult]:
        return () if self.stage.results is None else unit.results.put_all(self.stage.results, results)

    def _result(self, subject: str, made: _Made, part: Part[object]) -> AnyResult:
        return Result(
            subject=part.subject or subject,
            part=part.part,
            made_from=part.made_from or made.digest,
            numerics=self.context.code_version,
            recorded_ns=self.context.clock.now_ns(),
            value=part.value,
            status=part.status,
            reason=part.reason,
            head=part.head,
            parameters=part.parameters,
        )

    def _count(self, made: Mapping[str, _Made], changed: set[str], results: int) -> None:
        names = self.stage.counted
        self.counts[names.looked] += len(made)
        self.counts[names.changed] += results
        for subject, item in made.items():
            name = names.same if item.outcome is None or item.outcome.counted is None else item.outcome.counted
            if name is not None and subject not in changed and not (name == names.same and subject in self._stored):
                self.counts[name] += 1

    def keep(self, subject: str, state: Due, error: Exception) -> None:
        """Keep a subject in quarantine at which something failed."""
        self.isolation.keep(self.stage.kind, subject, _tried(self.inputs, state), error)
        if self.stage.failed is not None:
            with self.context.storage.write() as unit:
                self.stage.failed(unit, subject, error)


@dataclass(frozen=True, slots=True)
class _Made:
    """What came of a subject: the digest of its inputs, and what was computed; None where they were as before."""

    digest: str
    outcome: Outcome[object] | None

    @property
    def parts(self) -> Sequence[Part[object]]:
        return () if self.outcome is None else self.outcome.parts

    @property
    def more(self) -> bool:
        return self.outcome is not None and self.outcome.more

    def mark(self, state: Due) -> Mark:
        """Return what is noted of the subject."""
        if self.outcome is None:
            return Mark(state.seen, self.digest, state.again_ns)
        return Mark(state.seen, self.digest, self.outcome.again_ns, rests=self.outcome.rests)


def _tried(inputs: StageInputs, state: Due) -> str:
    """Return what stands for the inputs of a subject in quarantine: with others it is tried at once."""
    return f"{state.seen} {inputs.common[:16]}"


def _batches(subjects: Sequence[str], size: int) -> Iterator[tuple[str, ...]]:
    rest = iter(subjects)
    while batch := tuple(islice(rest, size)):
        yield batch
