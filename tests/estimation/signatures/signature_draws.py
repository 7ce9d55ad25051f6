"""Libraries drawn from the model that they are fitted with, so that everything about them is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.signatures import AxlePosition, ConicitySource, LibraryEntry, Place, Signature

Draw = Callable[..., list[LibraryEntry]]
PARAMETERS = SignatureParameters()
BANDS = PARAMETERS.bands


def signature(
    wheelset: str,
    place: Place | None,
    powers: np.ndarray,
    *,
    speed: float = 17.0,
    start_ns: int = 0,
    vehicle_class: str = "C",
    position: AxlePosition = AxlePosition.SINGLE,
) -> Signature:
    """Return a signature of these log powers (3 b,)."""
    spectra = np.zeros((BANDS, 9))
    spectra[:, :3] = np.exp(powers.reshape(3, BANDS).T)
    return Signature(wheelset, "V", vehicle_class, position, start_ns, 0, place, speed, spectra, 12.0)


@pytest.fixture(scope="session")
def draw() -> Draw:
    """Return what draws the entries of some wheelsets over some sections of four places each."""
    truth = np.random.default_rng(5)
    slope = truth.uniform(0.2, 1.5, 3 * BANDS)
    of_speed = truth.uniform(-0.3, 0.3, 3 * BANDS)

    def drawn(
        seed: int,
        conicities: np.ndarray,
        sections: int,
        *,
        first_section: int = 0,
        name: str = "W",
        noise: float = 0.05,
        own: float = 0.03,
        std: float = 0.003,
        start_ns: int = 0,
        shift: dict[Place, np.ndarray] | None = None,
        rougher: float = 0.0,
    ) -> list[LibraryEntry]:
        rng = np.random.default_rng(seed)
        found = []
        for number, conicity in enumerate(conicities):
            mine = own * rng.standard_normal(3 * BANDS)
            on_file = float(conicity + std * rng.standard_normal())
            for section in range(first_section, first_section + sections):
                tracks = np.random.default_rng([99, section])
                level = tracks.normal(0.0, 0.4) + rougher
                speed = float(rng.uniform(14, 20))
                for cell in range(4):
                    place = Place(f"S{section}", cell)
                    track = -14.0 + level + 0.15 * tracks.standard_normal(BANDS)
                    powers = np.tile(track, 3) + slope * np.log(conicity / 0.25) + of_speed * np.log(speed / 17)
                    powers += mine + noise * rng.standard_normal(3 * BANDS)
                    powers += (shift or {}).get(place, np.zeros(3 * BANDS))
                    one = signature(f"{name}{number}", place, powers, speed=speed, start_ns=start_ns + number)
                    found.append(
                        LibraryEntry(
                            one,
                            0,
                            on_file,
                            std,
                            ConicitySource.MEASURED_PROFILES,
                            (one.wheelset,),
                        )
                    )
        return found

    return drawn
