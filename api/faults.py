"""What is logged of an error: a short trace once, then how often it came back.

A fault is a type of error at a place in the code. A database that is away fails every request and every job the same
way: the first failure is written in full, those that follow are counted and summed up once a minute.
"""

from __future__ import annotations

import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import TracebackType

SUMMARY_S = 60.0
"""A fault that goes on is summed up this often, in seconds."""
FULL_AGAIN_S = 3600.0
"""After this long its trace is written again, in seconds."""
FAULTS = 500
"""Faults that are remembered; beyond, the one not seen for longest is forgotten."""
FRAMES, CAUSES, MESSAGE_CHARACTERS, TRACE_CHARACTERS = 12, 4, 500, 8000
"""Bounds of one trace: innermost calls of an error, errors behind it, characters of a message and of the whole."""

Fault = tuple[str, ...]


def fault_of(error: BaseException) -> Fault:
    """Return what identifies a fault: the types of the error and of its cause, and where it was raised."""
    place, trace = "", error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is not None:
        place = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
    cause = error.__cause__
    return (type(error).__qualname__, "" if cause is None else type(cause).__qualname__, place)


def short_trace(error: BaseException, clean: Callable[[str], str] = str) -> str:
    """Return a trace without local variables, bounded in depth and characters, the error itself first.

    Args:
        clean: Takes out of a message what must not be written, before the message is cut.
    """
    parts, one, seen = [], error, set[int]()
    for _ in range(CAUSES):
        seen.add(id(one))
        parts += [f"{_heading(one, clean)}\n", *_calls(one.__traceback__)]
        behind = one.__cause__ or (None if one.__suppress_context__ else one.__context__)
        if behind is None or id(behind) in seen:
            break
        parts.append("from ")
        one = behind
    return "".join(parts)[:TRACE_CHARACTERS].rstrip()


def _heading(error: BaseException, clean: Callable[[str], str]) -> str:
    heading = f"{type(error).__module__}.{type(error).__qualname__}: {error}"
    inside = "".join(f"\n  {type(one).__qualname__}: {one}" for one in getattr(error, "exceptions", ())[:CAUSES])
    return clean(heading)[:MESSAGE_CHARACTERS] + clean(inside)[:MESSAGE_CHARACTERS]


def _calls(trace: TracebackType | None) -> list[str]:
    return traceback.extract_tb(trace, limit=-FRAMES).format()


@dataclass(slots=True)
class _Seen:
    """What is known of one fault."""

    full_at_s: float
    written_at_s: float
    repeats: int = 0


@dataclass(slots=True)
class FaultLedger:
    """Decides which errors are written in full; for one thread at a time."""

    _seen: OrderedDict[Fault, _Seen] = field(default_factory=OrderedDict)

    def admits(self, fault: Fault, now_s: float) -> bool:
        """Return whether this occurrence is to be written in full; otherwise it is counted.

        Args:
            now_s: Of a clock that never goes back.
        """
        known = self._seen.get(fault)
        if known is not None and now_s - known.full_at_s < FULL_AGAIN_S:
            known.repeats += 1
            self._seen.move_to_end(fault)
            return False
        self._seen[fault] = _Seen(now_s, now_s)
        if len(self._seen) > FAULTS:
            self._seen.popitem(last=False)
        return True

    def due(self, now_s: float) -> Iterator[tuple[Fault, int, float]]:
        """Yield the faults to be summed up now: which, how often it came back, within how many seconds."""
        for fault, known in self._seen.items():
            since_s = now_s - known.written_at_s
            if known.repeats and since_s >= SUMMARY_S:
                yield fault, known.repeats, since_s
                known.repeats, known.written_at_s = 0, now_s

    def rest(self, now_s: float) -> Iterator[tuple[Fault, int, float]]:
        """Yield every fault that came back since it was last written; for the end of a process."""
        for fault, known in self._seen.items():
            if known.repeats:
                yield fault, known.repeats, now_s - known.written_at_s
                known.repeats = 0
