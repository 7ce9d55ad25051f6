"""Compiled functions, whose machine code numba keeps in files between processes.

What numba's own cache lacks is added. It ends with an exception where its directory can only be read, or a file is
damaged; it knows only changes of the file in which a function stands; and of two processes that write at once, one may
store its signature under the name of the other's. Here files are named by the digest of all that the machine code
depends on, a signature that is not the one asked for is not taken, and where files cannot be used, the function is
compiled in memory.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar, cast

import llvmlite
import numba
import numpy as np
from llvmlite.binding import get_host_cpu_name
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_log = logging.getLogger(__name__)
_config: Any = config  # its names are made when it is imported, from the environment (``NUMBA_...``)

OTHERS_MAY_WRITE = 0o002
NOT_KEPT = (
    "compiled code cannot be kept in %s (%s), so that every start compiles again for some seconds; "
    "name a directory that can be written in TREADWATCH_COMPILED_DIR, or fill it once: see docs/compiled-code.md"
)


def compiled(**options: bool | str) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Return a decorator that compiles a function at its first call, as ``numba.njit`` does, or loads what is kept."""
    wrapper: Any = numba.njit

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        dispatcher = wrapper(**options)(function)
        if dispatcher is not function:  # as it is where NUMBA_DISABLE_JIT leaves the function alone
            dispatcher._cache = _KernelCache(dispatcher.py_func)  # noqa: SLF001 - as numba does
        return cast("Callable[Arguments, Result]", dispatcher)

    return decorate


def directory() -> Path:
    """Return where machine code is kept: below ``NUMBA_CACHE_DIR``, else below the user's directory for caches.

    ``TREADWATCH_COMPILED_DIR`` of our commands sets ``NUMBA_CACHE_DIR``.
    """
    own = AppDirs("treadwatch", appauthor=False).user_cache_dir  # type: ignore[no-untyped-call]
    return Path(_config.CACHE_DIR or own) / "compiled"


class _Locator(_CacheLocator):
    def __init__(self, function: FunctionType) -> None:
        facts = (sorted(set(_depends_on(function, set()))), numba.__version__, llvmlite.__version__, np.__version__)
        chosen = (_config.CPU_NAME or get_host_cpu_name(), _config.OPT, _config.BOUNDSCHECK)
        self._digest = sha256(repr((facts, chosen)).encode()).hexdigest()[:40]

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> _Locator:  # noqa: ARG003 - numba's own
        return cls(py_func)

    def get_cache_path(self) -> str:
        return str(directory())

    def ensure_cache_path(self) -> None:
        directory().mkdir(mode=0o755, parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return self._digest


class _Implementation(CompileResultCacheImpl):
    """What the file of one signature holds, with a digest: at damaged machine code LLVM ends the process."""

    _locator_classes: Any = (_Locator,)

    def reduce(self, cres: Any) -> tuple[bytes, bytes]:  # noqa: ANN401 - numba's own
        content = dumps(super().reduce(cres))  # type: ignore[no-untyped-call]
        return sha256(content).digest(), content

    def rebuild(self, target_context: Any, payload: tuple[bytes, bytes]) -> Any:  # noqa: ANN401 - numba's own
        digest, content = payload
        if sha256(content).digest() != digest:
            raise ValueError("a file of compiled code is damaged")
        whole = pickle.loads(content)  # noqa: S301 - of a file that we may trust
        return super().rebuild(target_context, whole)  # type: ignore[no-untyped-call]


class _Files(FunctionCache):
    _impl_class = _Implementation


class _KernelCache(NullCache):
    """The files of one function, whatever state they are in."""

    warned = False  # once a process

    def __init__(self, function: FunctionType) -> None:
        self._function = function

    @cached_property
    def _files(self) -> Any:  # noqa: ANN401 - numba has no types
        files: Any = _Files
        return files(self._function)  # at the first call: the module that the function stands in is complete

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba's own
        """Return the compiled signature; None where it must be compiled."""
        try:
            if any(map(_others_may_write, (directory(), *self._paths()))):
                return None
            found = self._files.load_overload(sig, target_context)
        except OSError:
            return None
        except Exception:  # noqa: BLE001 - whatever is wrong with the files: new ones take their place
            with suppress(OSError):
                self._files.flush()
            return None
        return found if found is not None and found.signature.args == tuple(sig) else None

    def _paths(self) -> Iterator[Path]:
        index = Path(self._files._cache_file._index_path)  # noqa: SLF001 - numba says it nowhere else
        return directory().glob(f"{index.stem}.*")

    def _remove_untrusted(self) -> None:
        """Remove files that others may write: numba reads what is there before it adds to it."""
        if directory().exists() and _others_may_write(directory()):
            raise PermissionError("everybody may write there")
        for path in filter(_others_may_write, self._paths()):
            path.unlink()

    def save_overload(self, sig: Any, cres: Any) -> None:  # noqa: ANN401 - numba's own
        """Keep a compiled signature, where the directory can be written."""
        try:
            self._remove_untrusted()
            self._files.save_overload(sig, cres)
        except Exception as error:  # noqa: BLE001 - the compiled function is there, whatever is wrong with the files
            if not _KernelCache.warned:
                _log.warning(NOT_KEPT, directory(), error)
            _KernelCache.warned = True


def _others_may_write(path: Path) -> bool:
    return bool(path.stat().st_mode & OTHERS_MAY_WRITE)


def _depends_on(function: FunctionType, seen: set[FunctionType]) -> Iterator[str]:
    """Yield the sources of a function and of those that it calls, and the constants that they use."""
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
