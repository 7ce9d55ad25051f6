"""Damaged log files: what reading them costs, and which damage nothing shows."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bench.chaos.mutated_files import mutated, mutated_inside, small_recording, written
from bench.chaos.run import ChaosSettings
from bench.report import BenchRow
from estimation.errors import LogFileError
from ingest.align.windows import vehicle_samples
from ingest.catalogue import MOTION, POSITION, default_catalogue
from ingest.frames import FrameBatch, merge
from ingest.logs.formats import LogContent, ReadCost, read_content
from ingest.recordings import align_frames

INSIDE = "inside .blf"
FORMATS = (".blf", ".log", ".asc", INSIDE, ".mf4")
FEWER = {INSIDE: 4, ".mf4": 200}
"""So many times fewer files: python-can takes a second for the smallest MF4 file."""

MOST_SECONDS, MOST_BYTES = 10.0, 256 << 20
NO_DAMAGE = ("frames", "decoded", "time_frames", "syncs", "samples", "frames_moved", "lines_not_frames")
"""Counts that say nothing of damage."""

Values = frozenset[tuple[int, int, bytes]]


@dataclass(slots=True)
class Tally:
    """What became of the mutated files of one format."""

    files: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    most_s: float = 0.0
    most_cpu_s: float = 0.0
    most_bytes: int = 0
    over_memory: int = 0
    unexpected: str = ""

    def take_cost(self, cost: ReadCost) -> None:
        """Note what reading one file took."""
        self.most_cpu_s = max(self.most_cpu_s, cost.cpu_s)
        self.most_bytes = max(self.most_bytes, cost.memory_bytes)
        self.over_memory += cost.memory_bytes > MOST_BYTES


@dataclass(frozen=True, slots=True)
class Sound:
    """The recording before it was damaged."""

    batch: FrameBatch
    values: Values
    damage: Mapping[str, int]


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Damage files of each format and read them; yield what was found.

    ``size`` is the number of files of each format.
    """
    batch = small_recording()
    for name in FORMATS:
        if name == ".mf4" and find_spec("asammdf") is None:
            continue
        tally = _tally(batch, name, -(-settings.size // FEWER.get(name, 1)), settings)
        yield from _rows_of(name, tally)


def _tally(batch: FrameBatch, name: str, files: int, settings: ChaosSettings) -> Tally:
    suffix = Path(f"a{name.removeprefix('inside ')}").suffix
    original = written(batch, suffix, settings.folder)
    path = settings.folder / f"mutated{suffix}"
    path.write_bytes(original)
    content = read_content(path)
    values, damage = _values(content)
    sound = Sound(content.batch, values, damage)
    tally = Tally(files)
    for number in range(files):
        rng = np.random.default_rng([settings.seed, FORMATS.index(name), number])
        path.write_bytes(mutated_inside(original, rng) if name == INSIDE else mutated(original, suffix, rng))
        begin = time.monotonic()
        outcome = _outcome(path, sound, tally)
        tally.most_s = max(tally.most_s, time.monotonic() - begin)
        tally.outcomes[outcome] += 1
        if outcome == "crash":
            tally.unexpected = tally.unexpected or f"file {number} of seed {settings.seed}"
    return tally


def _outcome(path: Path, sound: Sound, tally: Tally) -> str:
    """Return what became of one file."""
    try:
        content = read_content(path, cost=tally.take_cost)
    except LogFileError as error:
        if "crashed" in error.reason:
            return "crash"
        return "over time" if "s of CPU" in error.reason or "longer than" in error.reason else "refused"
    except Exception:  # noqa: BLE001 - whatever else is raised is the finding
        return "crash"
    return _what_is_other(content, sound)


def _what_is_other(content: LogContent, sound: Sound) -> str:
    """Return how the content of a file differs from the sound one, and whether anything shows it."""
    if _same_frames(content.batch, sound.batch):
        return "same frames"
    values, damage = _values(content)
    if values <= sound.values:
        return "same values" if values == sound.values else "gaps"
    return "unmarked" if damage == sound.damage else "marked"


def _same_frames(batch: FrameBatch, other: FrameBatch) -> bool:
    return len(batch) == len(other) and all(
        np.array_equal(getattr(batch, name), getattr(other, name)) for name in ("t_ns", "arbitration_id", "dlc", "data")
    )


def _values(content: LogContent) -> tuple[Values, dict[str, int]]:
    """Return all samples and vehicle values at their instants, and the counts of damage."""
    catalogue = default_catalogue()
    aligned = align_frames(catalogue, merge([content.batch]))
    samples, counts = vehicle_samples("N-7", catalogue, aligned.messages)
    found: set[tuple[int, int, bytes]] = set()
    for number, node in samples.nodes.items():
        good = node.valid.all(axis=1)
        rows = zip(node.t_ns[good].tolist(), node.values[good], strict=True)
        found.update((number, t_ns, values.tobytes()) for t_ns, values in rows)
    for identifier, message in aligned.messages.items():
        if message.plan.kind in (MOTION, POSITION):
            raw = zip(message.tick.tolist(), np.ascontiguousarray(message.raw), strict=True)
            found.update((identifier, tick, values.tobytes()) for tick, values in raw)
    damage = {**asdict(aligned.frame_counts), **asdict(aligned.align_counts + counts), **content.counts}
    return frozenset(found), {name: count for name, count in damage.items() if count and name not in NO_DAMAGE}


def _rows_of(name: str, tally: Tally) -> Iterator[BenchRow]:
    outcomes = tally.outcomes
    crashes, slow = outcomes["crash"], outcomes["over time"]
    first = f" ({tally.unexpected})" if tally.unexpected else ""
    yield BenchRow(
        f"{name}: {tally.files:,} damaged files",
        f"{crashes} crashes{first}, {slow} ended for their time, {outcomes['refused']:,} refused with a reason, "
        f"{outcomes['same frames']:,} with the same frames",
        "0 crashes",
        crashes == 0,
    )
    yield BenchRow(
        f"{name}: cost of one file at most",
        f"{tally.most_s:.1f} s, {tally.most_cpu_s:.1f} s of CPU, {tally.most_bytes / (1 << 20):.0f} MiB",
        "< 10 s, < 256 MiB",
        tally.most_s < MOST_SECONDS and tally.over_memory == 0,
    )
    other = sum(outcomes[kind] for kind in ("same values", "gaps", "marked", "unmarked"))
    yield BenchRow(
        f"{name}: read with other frames",
        f"{other:,}: {outcomes['same values']:,} with the same samples, {outcomes['gaps']:,} with samples less, "
        f"{outcomes['marked']:,} with other samples and counts that show it, "
        f"{outcomes['unmarked']:,} with other samples that nothing shows",
        "none of BLF that nothing shows",
        name != ".blf" or outcomes["unmarked"] == 0,
    )
