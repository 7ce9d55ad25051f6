"""Every kernel as plain Python: a program, started with ``NUMBA_DISABLE_JIT=1``, that prints results and lines run."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from types import CodeType, FrameType
from typing import Protocol

import numpy as np
from kernel_runs import results


class Tracer(Protocol):
    """What the interpreter calls at every line of a function."""

    def __call__(self, frame: FrameType, event: str, _: object) -> Tracer | None:
        """Note the line, and return what to call at the next one."""


def interpreted(files: list[str]) -> None:
    """Print the results, and by file the lines of ``files`` that ran."""
    ran: defaultdict[str, set[int]] = defaultdict(set)
    left: dict[CodeType, set[int]] = {}  # lines that have not run; a function without any is traced no more

    def call(frame: FrameType, _: str, __: object) -> Tracer | None:
        code = frame.f_code
        if code not in left:
            left[code] = {line for *_, line in code.co_lines() if line} if code.co_filename in files else set()
            left[code].discard(code.co_firstlineno)
        return step if left[code] else None

    def step(frame: FrameType, event: str, _: object) -> Tracer:
        if event == "line":
            ran[frame.f_code.co_filename].add(frame.f_lineno)
            left[frame.f_code].discard(frame.f_lineno)
        return step

    sys.settrace(call)
    found = results()
    sys.settrace(None)
    numbers = {name: [np.asarray(array, float).ravel().tolist() for array in run] for name, run in found.items()}
    lines = {file: sorted(numbers) for file, numbers in ran.items()}
    json.dump({"results": numbers, "lines": lines}, sys.stdout)


if __name__ == "__main__":
    interpreted(sys.argv[1:])
