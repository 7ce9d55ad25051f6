"""What a service waits for at its start, and what it refuses at once."""

from __future__ import annotations

from threading import Event

import pytest

from api.factory import once_the_database_answers
from api.settings import Settings
from estimation.errors import MigrationError, ParameterError, StorageError

SERVER = Settings(database_url="postgresql://user@host/db", _env_file=None)
FILE = Settings(database_url="sqlite:////nowhere/at/all.sqlite", _env_file=None)


class Opening:
    """Fails in turn, then opens."""

    def __init__(self, *errors: Exception) -> None:
        self.errors = list(errors)
        self.attempts = 0

    def __call__(self) -> str:
        self.attempts += 1
        if self.errors:
            raise self.errors.pop(0)
        return "opened"


def test_a_server_that_is_away_is_waited_for() -> None:
    opening = Opening(StorageError("away"))
    assert once_the_database_answers(opening, SERVER, Event()) == "opened"
    assert opening.attempts == 2


@pytest.mark.parametrize("refusal", [MigrationError("0001", "0002"), ParameterError("of another length")])
def test_what_no_wait_mends_is_refused_as_soon_as_it_is_known(refusal: Exception) -> None:
    for errors in ([refusal], [StorageError("away"), refusal]):
        opening = Opening(*errors)
        with pytest.raises(type(refusal)):
            once_the_database_answers(opening, SERVER, Event())
        assert opening.attempts == len(errors)


def test_a_file_that_cannot_be_opened_is_refused_at_once() -> None:
    opening = Opening(StorageError("unable to open database file"))
    with pytest.raises(StorageError):
        once_the_database_answers(opening, FILE, Event())
    assert opening.attempts == 1


def test_a_stop_ends_the_wait() -> None:
    stopping = Event()

    def stopped() -> str:
        stopping.set()
        raise StorageError("away")

    assert once_the_database_answers(stopped, SERVER, stopping) is None
