"""Damaged log files: what reading them costs, and which damage nothing shows."""

from __future__ import annotations

import struct
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bench.chaos.run import ChaosSettings
from bench.logs import write_log
from bench.report import BenchRow
from estimation.errors import LogFileError
from ingest.align.windows import vehicle_samples
from ingest.catalogue import MOTION, POSITION, default_catalogue
from ingest.frames import FrameBatch, merge
from ingest.logs.formats import LogContent, ReadCost, read_content
from ingest.recordings import align_frames
from tests.ingest.vehicle_bus import Run

SECONDS, OFFSET_NS = 2.0, 37_123_456_000  # on whole microseconds, as text has them
Change = Callable[[bytearray, np.random.Generator], bytearray]


def mutated(original: bytes, suffix: str, rng: np.random.Generator) -> bytes:
    """Return a file to which one to three things have happened."""
    changes = [*ANY, *(TEXT if suffix in (".asc", ".log") else BINARY)]
    content = bytearray(original)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        content = changes[int(rng.integers(len(changes)))](content, rng)
    return bytes(content)


def mutated_inside(original: bytes, rng: np.random.Generator) -> bytes:
    """Return a BLF file whose inflated contents have changed: the checksum is right; a few are stored, or bombs."""
    contents = bytearray()
    at = 144
    while at < len(original):
        size = int.from_bytes(original[at + 8 : at + 12], "little")
        contents += zlib.decompress(original[at + 32 : at + size])
        at += size + size % 4
    kind = rng.random()
    if kind < BOMBS:
        return _bomb(original, contents, rng)
    changes = [*ANY, *BINARY]
    contents = changes[int(rng.integers(len(changes)))](contents, rng)
    return _blf(original, [_container(bytes(contents), len(contents), deflated=bool(rng.random() < 0.8))])


BOMBS = 0.02


def _bomb(original: bytes, contents: bytearray, rng: np.random.Generator) -> bytes:
    """Return a file that inflates to some hundred times its size: of zeros, or of frames."""
    size = int(rng.choice([1 << 22, 1 << 24, 1 << 26]))
    filling = bytes(size) if rng.random() < 0.5 else bytes(contents[:48]) * (size // 48)
    declared = int(rng.choice([len(filling), 4096, 0xFFFF_FFFF]))
    return _blf(original, [_container(filling, declared, deflated=True)] * int(rng.integers(1, 30)))


def _container(contents: bytes, declared: int, *, deflated: bool) -> bytes:
    packed = zlib.compress(contents, 1) if deflated else contents
    size = 32 + len(packed)
    head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + struct.pack("<H6xL4x", 2 if deflated else 0, declared)
    return head + packed + bytes(size % 4)


def _blf(original: bytes, containers: list[bytes]) -> bytes:
    body = b"".join(containers)
    return original[:16] + struct.pack("<Q", 144 + len(body)) + original[24:144] + body


def _span(content: bytearray, rng: np.random.Generator) -> slice:
    first = int(rng.integers(max(len(content), 1)))
    return slice(first, first + int(2 ** rng.uniform(0.0, 12.0)))


def _flip(content: bytearray, rng: np.random.Generator) -> bytearray:
    for _ in range(int(rng.choice([1, 1, 2, 8]))):
        content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
    return content


def _change(content: bytearray, rng: np.random.Generator) -> bytearray:
    content[int(rng.integers(len(content)))] = int(rng.integers(256))
    return content


def _cut(content: bytearray, rng: np.random.Generator) -> bytearray:
    return content[: int(rng.integers(1, len(content)))]


def _at_a_span(changed: Callable[[bytes, int, np.random.Generator], bytes]) -> Change:
    """Return what puts other bytes in place of those of a drawn span; it may end behind the file."""

    def change(content: bytearray, rng: np.random.Generator) -> bytearray:
        span = _span(content, rng)
        content[span] = changed(bytes(content[span]), span.stop - span.start, rng)
        return content or bytearray(b"\0")

    return change


_insert = _at_a_span(lambda part, size, rng: rng.bytes(size) + part)
_duplicate = _at_a_span(lambda part, _, __: part + part)
_delete = _at_a_span(lambda *_: b"")
_zero = _at_a_span(lambda part, _, __: bytes(len(part)))


def _swap(content: bytearray, rng: np.random.Generator) -> bytearray:
    first, second = _span(content, rng), int(rng.integers(len(content)))
    block = content[first]
    content[first] = content[second : second + len(block)]
    content[second : second + len(block)] = block
    return content


def _zero_header(content: bytearray, rng: np.random.Generator) -> bytearray:
    first = int(rng.integers(0, 144))
    content[first : first + 8] = bytes(len(content[first : first + 8]))
    return content


def _number(content: bytearray, rng: np.random.Generator) -> bytearray:
    at = int(rng.integers(len(content) // 4)) * 4 if rng.random() < 0.5 else int(rng.integers(200)) % len(content)
    value = int(rng.choice([0, 1, 0x7FFF_FFFF, 0xFFFF_FFFF, 0xFFFF, int(rng.integers(1 << 32))]))
    content[at : at + 4] = value.to_bytes(4, "little")[: len(content[at : at + 4])]
    return content


def _digit(content: bytearray, rng: np.random.Generator) -> bytearray:
    at = int(rng.integers(len(content)))
    while at < len(content) and not chr(content[at]).isalnum():
        at += 1
    if at < len(content):
        content[at] = b"0123456789ABCDEF"[int(rng.integers(16))]
    return content


def _line(content: bytearray, rng: np.random.Generator) -> bytearray:
    """Delete, repeat, exchange, shorten or blank a line."""
    lines = content.split(b"\n")
    at, other = (int(n) for n in rng.integers(len(lines), size=2))
    what = int(rng.integers(5))
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(other, lines[at])
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif what == 3:
        lines[at] = lines[at][: int(rng.integers(len(lines[at]) + 1))]
    else:
        lines[at] = bytearray(b" " * len(lines[at]))
    return bytearray(b"\n").join(lines)


ANY: tuple[Change, ...] = (_flip, _flip, _change, _cut, _insert, _duplicate, _delete, _swap, _zero)
BINARY: tuple[Change, ...] = (_number, _number, _zero_header)
TEXT: tuple[Change, ...] = (_digit, _digit, _line, _line)


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
    batch = Run(seconds=SECONDS, recorder_offset_ns=OFFSET_NS).frames()
    for name in FORMATS:
        if name == ".mf4" and find_spec("asammdf") is None:
            continue
        tally = _tally(batch, name, -(-settings.size // FEWER.get(name, 1)), settings)
        yield from _rows_of(name, tally)


def _tally(batch: FrameBatch, name: str, files: int, settings: ChaosSettings) -> Tally:
    suffix = Path(f"a{name.removeprefix('inside ')}").suffix
    path = settings.folder / f"mutated{suffix}"
    write_log(path, batch)
    original, content = path.read_bytes(), read_content(path)
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
