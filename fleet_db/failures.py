"""Errors of the database, translated into our own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError, IntegrityError, SQLAlchemyError, StatementError

from estimation.errors import ConflictError, ParameterError, StorageError


@contextmanager
def translate_errors() -> Iterator[None]:
    """Turn errors of SQLAlchemy and of the drivers into ours.

    Raises
    ------
    ConflictError
        A constraint of the database refused it.
    ParameterError
        A value that JSON cannot hold (NaN, infinity, an object).
    StorageError
        Everything else: unreachable, locked, full.
    """
    try:
        yield
    except IntegrityError as error:
        raise ConflictError(f"the database refused it: {_first_line(error.orig)}") from error
    except DBAPIError as error:
        raise StorageError(f"the database failed: {_first_line(error.orig)}") from error
    except StatementError as error:
        if isinstance(error.orig, ValueError | TypeError):
            raise ParameterError(f"cannot be stored: {_first_line(error.orig)}") from error
        raise StorageError(f"the database failed: {_first_line(error.orig)}") from error
    except SQLAlchemyError as error:
        raise StorageError(f"the database failed: {_first_line(error)}") from error


def _first_line(error: BaseException | None) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
