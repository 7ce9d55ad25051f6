"""Errors of the system at our own files as passing faults: nothing is wrong with what was to be stored or read."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode


@contextmanager
def passing_faults(path: Path) -> Iterator[None]:
    """Turn errors of the system into ours.

    Args:
        path: The file or folder of ours that is worked on.

    Raises:
        PassingFaultError: No space, no mount, no permission, a failing disk, no memory; names the path.
    """
    try:
        yield
    except OSError as error:
        raise passing_fault(error, path) from error


def passing_fault(error: OSError, path: Path) -> PassingFaultError:
    """Return an error of the system at a path of ours as ours."""
    code = ReasonCode.WAITS_FOR_MEMORY if error.errno == errno.ENOMEM else ReasonCode.WAITS_FOR_STORAGE
    return PassingFaultError(error.strerror or str(error), file=path, code=code)
