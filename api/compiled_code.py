"""Where compiled code is kept and for which CPU: our settings, handed to numba before it is imported."""

from __future__ import annotations

import json
import platform
from collections.abc import MutableMapping
from importlib import import_module
from pathlib import Path
from typing import Any

DIRECTORY, CPU = "TREADWATCH_COMPILED_DIR", "TREADWATCH_COMPILED_CPU"
PORTABLE = "portable"
GENERIC = ("generic", "")
LEVEL_3 = ("x86-64-v3", "+avx2,+fma,+bmi,+bmi2,+f16c,+lzcnt,+movbe")
"""Name and features, as LLVM takes them, of what servers have had since 2015."""
NEEDED_OF_LEVEL_3 = frozenset({"avx2", "fma", "bmi1", "bmi2", "f16c", "abm", "movbe"})  # as Linux names them
CPU_FACTS = Path("/proc/cpuinfo")


def choose_compiled_code(environment: MutableMapping[str, str], dot_env: Path = Path(".env")) -> None:
    """Say to numba, and to every process that this one starts, where compiled code is and for which CPU."""
    settings = _of_file(dot_env) | dict(environment)
    if settings.get(DIRECTORY):
        environment.setdefault("NUMBA_CACHE_DIR", str(Path(settings[DIRECTORY]).absolute()))
    if settings.get(CPU) == PORTABLE and "NUMBA_CPU_NAME" not in environment:
        environment["NUMBA_CPU_NAME"], environment["NUMBA_CPU_FEATURES"] = portable_cpu()


def portable_cpu(machine: str | None = None, facts: Path = CPU_FACTS) -> tuple[str, str]:
    """Return name and features of the CPU to compile for, so that other machines load the same code."""
    try:
        lines = facts.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    flags = next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), [])
    wide = (machine or platform.machine()) == "x86_64" and set(flags) >= NEEDED_OF_LEVEL_3
    return LEVEL_3 if wide else GENERIC


def _of_file(path: Path) -> dict[str, str]:
    if not path.is_file():
        return {}
    from dotenv import dotenv_values  # noqa: PLC0415 - most starts have no such file

    found = dotenv_values(path, interpolate=False)
    return {name: value for name in (DIRECTORY, CPU) if (value := found.get(name))}


SIGNATURES = Path(__file__).with_name("kernel_signatures.json")  # a test compares it with runs of every kernel


def compile_kernels() -> None:
    """Compile every kernel with every type of arguments, or load what is already there."""
    for name, signatures in json.loads(SIGNATURES.read_text(encoding="utf-8")).items():
        kernel = _named(name)
        for signature in signatures:
            kernel.compile(tuple(_type_of(described) for described in signature))


def _named(path: str) -> Any:  # noqa: ANN401 - a compiled function, or a class
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


def _type_of(described: Any) -> Any:  # noqa: ANN401 - JSON, and a type of numba
    """Return a type: a scalar, an array with its dimensions, a tuple of types, or a named tuple by its class."""
    import numba  # noqa: PLC0415 - not before it knows its directory
    import numpy as np  # noqa: PLC0415 - the same

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
