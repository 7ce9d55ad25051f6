"""What the conicities on file may be off by, and how much of that is each wheelset's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from signature_draws import Draw

from estimation.signatures.calibration import SHARES, Differences, OnFile, judged_by, unjudged
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.signatures import ConicitySource, LibraryEntry

CONICITIES = np.linspace(0.16, 0.36, 21)
CLAIMED = 0.01


def geometries(draw: Draw, std: float = CLAIMED) -> list[LibraryEntry]:
    drawn = draw(0, CONICITIES, 1, std=1e-6)
    return [replace(one, std=std, source=ConicitySource.GEOMETRY) for one in drawn]


def seen(of: OnFile, std: float, answers: float = 6.0, wheelsets: int = 28) -> OnFile:
    """Return what is on file after differences whose squares are all those of ``std``."""
    one = np.ones(wheelsets)
    claimed = float(np.max(of.claimed)) ** 2
    own = float(np.max(of.own)) ** 2
    return judged_by(of, Differences(std * one, answers * one, own * one, claimed * one), SignatureParameters())


def share(of: OnFile) -> float:
    return float(of.shares @ SHARES)


def slow_posterior(std: float, answers: float, wheelsets: int) -> float:
    """Return the expected share by sums over shares and standard deviations of answers, one at a time."""
    total = weighed = 0.0
    for part in SHARES:
        for z in np.linspace(-3.0, 3.0, 31):
            variance = (0.006 * np.exp(0.3 * z)) ** 2 / answers + part * CLAIMED**2
            density = np.exp(-0.5 * wheelsets * (std**2 / variance + np.log(variance / 1e-4)) - 0.5 * z**2)
            total += (1.0 - part) ** 3 * density
            weighed += part * (1.0 - part) ** 3 * density
    return float(weighed / total)


@pytest.mark.parametrize(("std", "answers", "wheelsets"), [(0.008, 6.0, 28), (0.003, 2.0, 11), (0.005, 1.0, 11)])
def test_the_share_is_the_mean_of_its_posterior(draw: Draw, std: float, answers: float, wheelsets: int) -> None:
    found = share(seen(unjudged(geometries(draw)), std, answers, wheelsets))
    assert found == pytest.approx(slow_posterior(std, answers, wheelsets), rel=1e-6)
    assert (
        SignatureParameters().answer_std,
        SignatureParameters().answer_spread,
        SignatureParameters().reluctance,
    ) == (0.006, 0.3, 3)


def test_differences_that_answers_explain_are_not_the_wheelsets_own(draw: Draw) -> None:
    before = unjudged(geometries(draw))
    assert share(seen(before, 0.002)) < 0.1
    assert share(seen(before, 0.0085)) > 0.4
    assert share(seen(before, 0.004, answers=1.0, wheelsets=11)) < 0.15, "one section says little of a wheelset"


def test_all_of_the_claimed_variance_is_either_own_or_in_common(draw: Draw) -> None:
    of = seen(unjudged(geometries(draw)), 0.007)
    np.testing.assert_allclose(of.alone, np.sqrt(share(of)) * CLAIMED)
    np.testing.assert_allclose(of.shared_std(0.25) ** 2, (1.0 - SHARES) * CLAIMED**2, rtol=1e-9)


def test_of_measured_profiles_as_much_is_own_as_the_differences_hold(draw: Draw) -> None:
    before = unjudged(draw(0, CONICITIES, 1, std=0.006))
    np.testing.assert_allclose(before.alone, 0.006)
    all_own, half = seen(before, 0.008), seen(before, 0.006 * np.sqrt(0.5))
    np.testing.assert_allclose(all_own.alone, 0.006)
    np.testing.assert_allclose(all_own.shared_std(0.25), 0.0, atol=1e-12)
    np.testing.assert_allclose(half.alone, 0.006 * np.sqrt(0.5))
    np.testing.assert_allclose(half.shared_std(0.25), 0.006 * np.sqrt(0.5))


def test_sources_have_shares_of_their_own(draw: Draw) -> None:
    entries = geometries(draw)
    entries[: len(entries) // 2] = [
        replace(one, source=ConicitySource.MEASURED_PROFILES, std=0.003) for one in entries[: len(entries) // 2]
    ]
    before = unjudged(entries)
    measured = np.arange(20) < 10
    found = judged_by(
        before,
        Differences(np.where(measured, 0.004, 0.002), np.full(20, 2.0), 9e-6 * measured, 1e-4 * ~measured),
        SignatureParameters(),
    )
    np.testing.assert_allclose(found.own.max(), 0.003)
    assert share(found) < 0.1


def test_what_is_shared_adds_up_as_it_is_and_counts_near_by(draw: Draw) -> None:
    entries = [replace(one, std=0.02 if one.conicity < 0.2 else 0.002) for one in geometries(draw)]
    of = unjudged(entries)
    whole = [float(of.shared_std(conicity)[0]) for conicity in (0.16, 0.34)]
    assert whole[1] == pytest.approx(np.mean([one.std for one in entries]), rel=1e-6)
    near = np.exp(-0.5 * ((of.conicity - 0.16) / 0.03) ** 2)
    assert whole[0] == pytest.approx(near @ of.claimed / near.sum())
    assert whole[0] > 1.5 * whole[1]
    assert SIGNATURE.near_conicity == 0.03
