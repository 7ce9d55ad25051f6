"""Compiled functions, and the directory that keeps their machine code between processes.

numba keeps compiled code by itself, but ends with an exception where no directory can be written, knows only changes
of the file in which a function stands, and loads what was damaged or written by two processes at the same time.
Here every compiled signature is one file under the digest of all that it depends on: the source of the function and of
the compiled functions that it calls, the constants that it uses, types, versions and CPU. The file begins with the
digest of its content. What is absent, damaged or of another CPU is compiled; what cannot be written is compiled in
memory, with one warning a process.
"""

from __future__ import annotations

import logging
import pickle
import platform
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar, cast
from uuid import uuid4

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_log = logging.getLogger(__name__)
_config: Any = config  # its names are made when it is imported, from the environment (``NUMBA_...``)

DIGEST_BYTES = 32
OTHERS_MAY_WRITE = 0o002
SUFFIX = ".compiled"
NOT_KEPT = (
    "compiled code cannot be kept in %s (%s), so that every start compiles again for some seconds; "
    "name a directory that can be written in TREADWATCH_COMPILED_DIR, or fill it once with 'treadwatch compile'"
)


@dataclass(slots=True)
class Compilations:
    """How many signatures this process loaded, compiled, and could not keep."""

    loaded: int = 0
    compiled: int = 0
    not_kept: int = 0


COUNTS = Compilations()


def compiled(**options: bool | str) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Return a decorator that compiles a function at its first call, as ``numba.njit`` does, or loads what is kept."""
    wrapper: Any = numba.njit

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        dispatcher = wrapper(**options)(function)
        if dispatcher is not function:  # as it is where NUMBA_DISABLE_JIT leaves the function alone
            dispatcher._cache = KernelCache(dispatcher.py_func, sorted(options.items()))  # noqa: SLF001 - as numba does
        return cast("Callable[Arguments, Result]", dispatcher)

    return decorate


def directories() -> tuple[Path, ...]:
    """Return where compiled code is looked for and, in this order, kept where it can be written.

    First the directory that ``NUMBA_CACHE_DIR`` names (``TREADWATCH_COMPILED_DIR`` of our commands sets it), then the
    user's own for caches (``XDG_CACHE_HOME``, ``~/.cache``).
    """
    own = AppDirs("treadwatch", appauthor=False).user_cache_dir  # type: ignore[no-untyped-call]
    named = _config.CACHE_DIR
    return tuple(Path(base) / "compiled" for base in dict.fromkeys((named or own, own)))


class KernelCache:
    """The compiled signatures of one function, as numba's dispatcher asks for them."""

    def __init__(self, function: FunctionType, options: list[tuple[str, bool | str]]) -> None:
        self._function = function
        self._options = options

    @property
    def cache_path(self) -> str:
        """Directory of the files."""
        return str(directories()[0])

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba's own
        """Return the compiled signature; None where it must be compiled."""
        target_context.refresh()
        name = self._name(sig, target_context.codegen())
        content = next((found for found in (_read(base / name) for base in directories()) if found is not None), None)
        if content is None:
            return None
        try:
            found = CompileResult._rebuild(target_context, *pickle.loads(content))  # type: ignore[no-untyped-call]  # noqa: S301, SLF001 - our file
        except Exception:  # noqa: BLE001 - whatever is wrong with kept code: it is compiled again
            return None
        COUNTS.loaded += 1
        return found

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba's own
        """Keep a compiled signature, where a directory can be written."""
        COUNTS.compiled += 1
        content = dumps(data._reduce())  # type: ignore[no-untyped-call]  # noqa: SLF001 - numba's own caches do the same
        name = self._name(sig, data.codegen)
        refused: list[OSError] = []
        for base in directories():
            error = _write(base / name, content)
            if error is None:
                return
            refused.append(error)
        if not COUNTS.not_kept:
            _log.warning(NOT_KEPT, directories()[0], refused[0].strerror or refused[0])
        COUNTS.not_kept += 1

    def enable(self) -> None:
        """Do nothing: the cache is always in use."""

    def disable(self) -> None:
        """Do nothing: the cache is always in use."""

    def flush(self) -> None:
        """Do nothing: a file of another source has another name."""

    def _name(self, sig: Any, codegen: Any) -> str:  # noqa: ANN401 - numba's own
        facts = (sig, codegen.magic_tuple(), _versions(), _config.OPT, _config.BOUNDSCHECK, self._options)
        key = sha256(f"{self._source}\n{facts}".encode()).hexdigest()
        return f"{self._function.__qualname__}-{key[:40]}{SUFFIX}"

    @cached_property
    def _source(self) -> str:
        return "\n".join(sorted(set(_depends_on(self._function, set()))))


def _depends_on(function: FunctionType, seen: set[FunctionType]) -> Iterator[str]:
    if function in seen:
        return
    seen.add(function)
    yield f"{function.__module__}.{function.__qualname__} {_source_digest(Path(function.__code__.co_filename))}"
    for name in _names(function.__code__):
        value = function.__globals__.get(name)
        if isinstance(value, Dispatcher):
            yield from _depends_on(value.py_func, seen)
        elif isinstance(value, (int, float, str, tuple)):
            yield f"{function.__module__}.{name} = {value!r}"
        elif isinstance(value, type):
            yield f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}"


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


@cache
def _source_digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


@cache
def _versions() -> tuple[str, ...]:
    return (platform.python_implementation(), platform.python_version(), numba.__version__, llvmlite.__version__,
            np.__version__)  # fmt: skip


def _read(path: Path) -> bytes | None:
    """Return the content of a file; None where there is none, it is damaged, or everybody may have written it."""
    try:
        if (path.stat().st_mode | path.parent.stat().st_mode) & OTHERS_MAY_WRITE:
            return None
        stored = path.read_bytes()
    except OSError:
        return None
    content = stored[DIGEST_BYTES:]
    return content if sha256(content).digest() == stored[:DIGEST_BYTES] else None


def _write(path: Path, content: bytes) -> OSError | None:
    """Write a file as a whole or not at all; return why not. Others that write the same replace it by the same."""
    part = path.with_name(f".{path.stem}-{uuid4().hex[:12]}")
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        part.write_bytes(sha256(content).digest() + content)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        return error
    return None
