"""Changes of the registry by REST: under preconditions, entered as a file is, answered with the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Literal

from fastapi import Response
from pydantic import BaseModel, Field

from api.answers import require_match
from api.asking import CODE, AskedChange
from api.schemas.common import Body
from estimation.errors import InputError
from fleet_db.records import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.input_file import MEBIBYTE, Location, dotted
from ingest.registry_entry.contents import Entry, RegistryContents, Rule
from ingest.registry_entry.enter import enter

TEXT = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"


MOST_KM = 1e8


Confirmable = Literal["odometer_backwards", "odometer_jump", "unknown_profile", "unusual_gauge", "unusual_radius"]


Key = Annotated[str, Field(pattern=CODE)]


Note = Annotated[str, Field(max_length=2000, pattern=TEXT)]


Kilometres = Annotated[float, Field(ge=0.0, le=MOST_KM)]


class RegistryChange(Body):
    """What every change of the registry may say."""

    why: Note = Field(default="", description="Kept with the record in its history.", examples=["work order 4711"])
    by: Key | None = Field(
        default=None, description="Who; read only where access control is off.", examples=["j.smith"]
    )
    confirm: list[Confirmable] = Field(
        default=[], description="Doubts of a refusal that are unfounded: it is so all the same.", examples=[[]]
    )


MOST_TEXT = MEBIBYTE  # of one file; a request has at most as much


UNNAMED = "unnamed client"  # who changes something where access is open and nobody says who it is


@dataclass(frozen=True, slots=True)
class BodySource:
    """Names the field of a request's body for a field of a registry file.

    Attributes:
        names: By field of the file; by array and index before it (``mountings[1].from``) where several records are
            entered.
    """

    names: Mapping[str, str] = field(default_factory=dict)

    def error(self, reason: str, location: Location = ()) -> InputError:
        """Return the error that names the field of the body."""
        last = next((str(part) for part in location[2:3]), "")
        return InputError(reason, field=self.names.get(dotted(location)) or self.names.get(last, last) or None)


@dataclass(frozen=True, slots=True)
class RegistryRequest:
    """A request that changes the registry."""

    asked: AskedChange
    body: RegistryChange

    def visible(self, find: Callable[[SqlUnitOfWork], object]) -> None:
        """Refuse what the body names and the caller does not see, as if it did not exist."""
        with self.asked.read() as unit:
            find(unit)

    def change(
        self,
        current: Callable[[SqlUnitOfWork], BaseModel] | None,
        apply: Callable[[SqlUnitOfWork, Decision], BaseModel],
        status: HTTPStatus = HTTPStatus.CREATED,
    ) -> Response:
        """Change something once, in one transaction; ``current`` is what ``If-Match`` is of, None if new."""

        def entered(unit: SqlUnitOfWork, now_ns: int) -> BaseModel:
            if current is not None:
                require_match(self.asked.if_match, current(unit))
            return apply(unit, Decision(self.asked.caller.acts_as(self.body.by, UNNAMED), self.body.why, now_ns))

        return self.asked.once(self.body, entered, status)

    def enter(self, unit: SqlUnitOfWork, decision: Decision, contents: RegistryContents, source: BodySource) -> None:
        """Enter records as a registry file does."""
        confirmed = frozenset(map(Rule, self.body.confirm))
        enter(contents, unit, source, Entry(decision, decision.recorded_ns, confirmed))
