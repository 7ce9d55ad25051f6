"""``treadwatch compile``: machine code of every compiled function, before the first start needs it."""

from __future__ import annotations

import json
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

from estimation.errors import StorageError

SIGNATURES = Path(__file__).parents[1] / "kernel_signatures.json"  # a test compares it with runs of every kernel


def compile_kernels() -> None:
    """Compile every kernel into TREADWATCH_COMPILED_DIR, or load what is already there."""
    from estimation.compiled import COUNTS, directories

    started = time.process_time()
    for name, signatures in json.loads(SIGNATURES.read_text(encoding="utf-8")).items():
        kernel = _named(name)
        for signature in signatures:
            kernel.compile(tuple(_type_of(described) for described in signature))
    if COUNTS.not_kept:
        raise StorageError(f"{directories()[0]}: {COUNTS.not_kept} compiled functions could not be written")
    typer.echo(
        f"{COUNTS.compiled} compiled, {COUNTS.loaded} already there, {time.process_time() - started:.1f} s of CPU"
    )


def _named(path: str) -> Any:  # noqa: ANN401 - a compiled function, or a class
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def _type_of(described: Any) -> Any:  # noqa: ANN401 - JSON, and a type of numba
    """Return a type: a scalar, an array with its dimensions, a tuple of types, or a named tuple by its class."""
    import numba
    import numpy as np

    types: Any = numba.types
    if isinstance(described, dict):
        ((name, parts),) = described.items()
        return types.BaseTuple.from_types([_type_of(part) for part in parts], pyclass=_named(name))
    if isinstance(described, list):
        return types.BaseTuple.from_types([_type_of(part) for part in described])
    kind, *dimensions = described.split()
    scalar = numba.from_dtype(np.dtype(kind))
    if not dimensions:
        return scalar
    return types.Array(scalar, int(dimensions[0]), "C", readonly="readonly" in dimensions)
