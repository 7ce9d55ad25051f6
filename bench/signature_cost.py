"""What signatures cost: to make them, and to judge a fleet of 200 wheelsets again after one new window."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from bench.signature_cases import SimulatedFleet, entries, tracks, wheelset, window_of, window_parameters
from estimation.signatures.answer import judged
from estimation.signatures.library import Libraries, Library, Subject
from estimation.signatures.window_signatures import SignatureParameters, window_signatures
from estimation.values.signatures import AxlePosition, LibraryEntry

WHEELSETS, EACH = 200, 20
SECONDS_PER_HOUR = 3600.0


def cost(made: SimulatedFleet) -> dict[str, float]:
    """Return what signatures cost, CPU seconds."""
    shared, apart = judging(made)
    return {"signing": signing(), "shared": shared, "apart": apart}


def signing() -> float:
    """Return the CPU seconds that signatures of an hour of one wheelset take, samples in memory."""
    (track,) = tracks(1, 0).values()
    rng = np.random.default_rng(0)
    window = window_of(wheelset("W", 0.5e-3, 2, rng), "S0", track, 17.0, rng)
    window_signatures(window, window_parameters(), SignatureParameters())  # compiled
    began = time.process_time()
    for _ in range(5):
        window_signatures(window, window_parameters(), SignatureParameters())
    return (time.process_time() - began) / 5 / (1e-9 * window.length_ns) * SECONDS_PER_HOUR


def judging(made: SimulatedFleet) -> tuple[float, float]:
    """Return the CPU seconds of judging 200 wheelsets: with shared libraries, and each with its own (from one)."""
    known, parameters = _large(made), SignatureParameters()
    began = time.process_time()
    libraries = Libraries(known, parameters)
    by_wheelset: dict[str, list[LibraryEntry]] = {}
    for entry in known:
        by_wheelset.setdefault(entry.wheelset, []).append(entry)
    for serial, own in by_wheelset.items():
        subject = Subject(serial, own[0].signature.vehicle_class, AxlePosition.SINGLE)
        libraries.admitted(subject)
        found = libraries.library(subject)
        assert isinstance(found, Library)
        judged(serial, [one.signature for one in own], found, parameters)
    shared = time.process_time() - began
    began = time.process_time()
    Libraries(known, parameters).library(subject)
    return shared, WHEELSETS * (time.process_time() - began)


def _large(made: SimulatedFleet) -> list[LibraryEntry]:
    """Return entries of as many wheelsets: those of the fleet again and again, each copy with other stretches."""
    found: list[LibraryEntry] = []
    own: dict[str, list[LibraryEntry]] = {}
    for entry in entries(made.teaching, np.random.default_rng(0), 0.003):
        own.setdefault(entry.wheelset, []).append(entry)
    serials, rng = sorted(own), np.random.default_rng(1)
    for number in range(WHEELSETS):
        members, name = own[serials[number % len(serials)]], f"C{number}"
        chosen = [members[at] for at in rng.choice(len(members), EACH, replace=False)]
        found += [replace(one, signature=replace(one.signature, wheelset=name)) for one in chosen]
    return found
