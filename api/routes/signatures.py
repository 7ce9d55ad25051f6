"""What the wear signatures of a wheelset show."""

from __future__ import annotations

from fastapi import APIRouter, Response

from api.asking import AskedDep
from api.parameters import Serial
from api.problems import described
from api.schemas import signatures
from estimation.errors import NotFoundError
from estimation.values.signatures import ANSWERS

router = APIRouter(prefix="/v1/wheelsets", tags=["wheelsets"])


@router.get("/{serial}/signature", response_model=signatures.SignatureAnswer, responses=described(404))
def get_signature(asked: AskedDep, serial: Serial) -> Response:
    """Return what a library of the other wheelsets' raw signals says of the wheelset, beside its geometry."""
    with asked.read() as unit:
        unit.registry.wheelset(serial)
        found = unit.results.latest(ANSWERS, serial)
        if found is None or found.value is None:
            raise NotFoundError("signature yet of wheelset", serial)
        seen = {one.serial for one in unit.registry.wheelsets_of([one.wheelset for one in found.value.answer.used])}
    return asked.answer(signatures.signature_answer(found, seen))
