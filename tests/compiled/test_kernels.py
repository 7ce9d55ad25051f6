"""Every compiled kernel runs once without the compiler, line by line, and gives what it gives compiled."""

from __future__ import annotations

import json
import linecache
import os
import subprocess
import sys
from pathlib import Path
from types import CodeType
from typing import Any

import interpreted_runs
import numpy as np
import pytest
from kernel_runs import product_kernels, results

RUNS = Path(interpreted_runs.__file__)

GUARDS = {
    ("estimation.contact.kernels._refine", "return high"),
    ("estimation.contact.kernels._refine", "return 0.5 * (low + high)"),
    ("estimation.contact.kernels._is_jump", "return False"),
}
"""Lines against inputs that no pair of profiles here makes."""


@pytest.fixture(scope="module")
def kernels() -> dict[str, CodeType]:
    """Return the code of every compiled function of the product."""
    return {name: kernel.py_func.__code__ for name, kernel in product_kernels().items()}


@pytest.fixture(scope="module")
def interpreted(kernels: dict[str, CodeType]) -> dict[str, Any]:
    """Return results and lines of one process whose compiler is off."""
    files = {code.co_filename for code in kernels.values()}
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, RUNS, *files], env=environment, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_every_line_of_every_kernel_runs(kernels: dict[str, CodeType], interpreted: dict[str, Any]) -> None:
    assert len(kernels) >= 30
    missed = set()
    for name, code in kernels.items():
        lines = {line for _, _, line in code.co_lines() if line is not None and line != code.co_firstlineno}
        for line in lines - set(interpreted["lines"].get(code.co_filename, ())):
            missed.add((name, linecache.getline(code.co_filename, line).strip()))
    assert missed == GUARDS


def test_kernels_give_the_same_compiled(interpreted: dict[str, Any]) -> None:
    for name, compiled in results().items():
        plain = interpreted["results"][name]
        assert len(plain) == len(compiled)
        for one, other in zip(plain, compiled, strict=True):
            np.testing.assert_allclose(np.array(one, float), np.ravel(other), rtol=1e-9, atol=1e-12, err_msg=name)
