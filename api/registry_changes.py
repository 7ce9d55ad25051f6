"""Changes of the registry by REST: under preconditions, entered as a file is, answered with the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus

from fastapi import Response
from pydantic import BaseModel

from api.answers import answer, require_match
from api.asking import AskedChange
from api.idempotency import IdempotentPost, idempotent_post
from api.schemas.registry_changes import RegistryChange
from estimation.errors import InputError
from fleet_db.registry_events import Decision
from fleet_db.storage import SqlUnitOfWork
from ingest.input_file import Location, dotted
from ingest.registry_entry.contents import Entry, RegistryContents, Rule
from ingest.registry_entry.enter import enter

UNNAMED = "unnamed client"
"""Who changes something where access is open and nobody says who it is."""


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
    """A request that changes the registry.

    Attributes:
        asked: Its ``if_match`` is None in requests that create something.
    """

    asked: AskedChange
    body: RegistryChange

    def decision(self, now_ns: int) -> Decision:
        """Return who decides, why, and when."""
        return Decision(self.asked.caller.acts_as(self.body.by, UNNAMED), self.body.why, now_ns)

    def visible(self, find: Callable[[SqlUnitOfWork], object]) -> None:
        """Refuse what the body names and the caller does not see, as if it did not exist.

        Args:
            find: Raises where there is no such thing in a transaction that shows the caller's fleets only.
        """
        with self.asked.read() as unit:
            find(unit)

    def change(
        self,
        current: Callable[[SqlUnitOfWork], BaseModel] | None,
        apply: Callable[[SqlUnitOfWork, Decision], BaseModel],
        status: HTTPStatus = HTTPStatus.CREATED,
    ) -> Response:
        """Change something in one transaction; the same request again changes nothing and gets the same answer.

        Args:
            current: Representation of the asset that is changed, for ``If-Match``; None where there is none yet.
            apply: Changes it; returns what is answered.
        """
        post: IdempotentPost = idempotent_post(self.asked.request, self.asked.key, self.body)
        now_ns = self.asked.services.clock.now_ns()
        with self.asked.services.storage.write() as unit:
            earlier = post.earlier(self.asked.request, unit)
            if earlier is not None:
                return earlier
            if current is not None:
                require_match(self.asked.if_match, current(unit))
            done = apply(unit, self.decision(now_ns))
            post.remember(unit, status, done, now_ns)
        return answer(self.asked.request, done, status=status)

    def enter(self, unit: SqlUnitOfWork, decision: Decision, contents: RegistryContents, source: BodySource) -> None:
        """Enter records as a registry file does.

        Raises:
            RegistryRefusedError: They are impossible or contradict what is on file.
        """
        confirmed = frozenset(map(Rule, self.body.confirm))
        enter(contents, unit, source, Entry(decision, decision.recorded_ns, confirmed))
