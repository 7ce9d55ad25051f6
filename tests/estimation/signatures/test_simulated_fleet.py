"""A small simulated fleet, from windows to answers: against the truth of the simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.signature_cases import SimulatedFleet, entries
from bench.signature_fleets import Plan, fleet
from estimation.signatures.answer import judged
from estimation.signatures.library import Library, library
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.signatures import Basis

pytestmark = pytest.mark.slow

PARAMETERS = SignatureParameters()


@pytest.fixture(scope="module")
def small() -> SimulatedFleet:
    return fleet(Plan(teachers=14, judged=7, sections=3, others=1), 2)


@pytest.fixture(scope="module")
def of(small: SimulatedFleet) -> Library:
    found = library(entries(small.teaching, np.random.default_rng(0), 0.003), PARAMETERS)
    assert isinstance(found, Library)
    return found


@pytest.mark.parametrize(("basis", "most"), [(Basis.SAME_PLACES, 0.015), (Basis.OTHER_PLACES, 0.03)])
def test_unseen_wheelsets_are_judged_on_seen_and_on_unseen_sections(
    small: SimulatedFleet, of: Library, basis: Basis, most: float
) -> None:
    errors, held = [], []
    for one in small.same if basis is Basis.SAME_PLACES else small.other:
        answer = judged(one.wheelset.serial, one.signatures, of, PARAMETERS)
        conicity = answer.conicity
        if conicity.value is None or conicity.low is None or conicity.high is None:
            continue
        assert answer.basis is basis
        errors.append(abs(conicity.value - one.wheelset.conicity))
        held.append(conicity.low <= one.wheelset.conicity <= conicity.high)
    assert len(errors) >= 5
    assert max(errors) < most
    assert np.mean(held) >= 0.8


def test_no_position_is_no_hindrance(small: SimulatedFleet, of: Library) -> None:
    errors = []
    for one in small.same:
        unplaced = [replace(item, place=None) for item in one.signatures]
        conicity = judged(one.wheelset.serial, unplaced, of, PARAMETERS).conicity
        if conicity.value is not None:
            errors.append(abs(conicity.value - one.wheelset.conicity))
    assert len(errors) >= 5
    assert max(errors) < 0.03
