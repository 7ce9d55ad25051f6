"""A wheelset that sways: linear creep that saturates, a flange, and a track; below and above its critical speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray

STEP = 1e-3  # s
STRIDE = 4  # steps a sample


@dataclass(frozen=True)
class Swaying:
    """Lateral and yaw acceleration of a wheelset of 1,250 kg, sampled at 250 Hz."""

    lateral: FloatArray
    yaw: FloatArray
    speed: FloatArray
    interval_s: float = STEP * STRIDE

    def clipped(self, limit: float) -> Swaying:
        """Return what sensors of a range give."""
        return Swaying(np.clip(self.lateral, -limit, limit), np.clip(self.yaw, -limit, limit), self.speed)


def rough_track(speed: float, seconds: float, std: float, seed: int = 0) -> FloatArray:
    """Return an alignment of 2 to 60 m wavelength, m at every step."""
    n = round(seconds / STEP)
    per_m = np.fft.rfftfreq(n, STEP * speed)
    amplitude = np.where((per_m > 1 / 60) & (per_m < 1 / 2), (1e-4 + per_m**2) ** -0.75, 0.0)
    phase = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(per_m)))
    track = np.fft.irfft(amplitude * phase, n)
    return np.asarray(std * track / track.std())


def sway(speed: float, conicity: float, yaw_stiffness: float, track: FloatArray) -> Swaying:
    """Return the motion on a track; it begins with 3 mm."""
    f11, f22, mass, inertia, half, radius = 7.44e6, 6.79e6, 1250.0, 700.0, 0.7452, 0.45
    most_force = 0.35 * 9250.0 * 9.81
    y, v, psi, rate = 3e-3, 0.0, 0.0, 0.0
    found = np.empty((len(track), 2))
    for i, d in enumerate(track.tolist()):
        x = y - d
        beyond = np.sign(x) * max(abs(x) - 6e-3, 0.0)  # into the flange
        flange = -4e7 * beyond - (4e4 * v if beyond else 0.0)
        difference = 2.0 * conicity * x + 0.6 * beyond
        lateral = most_force * np.tanh(-2.0 * f22 * (v / speed - psi) / most_force)
        moment = -half * f11 * difference / radius - 2.0 * half**2 * f11 * rate / speed
        most = most_force * half
        found[i] = (
            (lateral + flange) / mass,
            (most * np.tanh(moment / most) - yaw_stiffness * psi) / inertia,
        )
        v, rate = v + found[i, 0] * STEP, rate + found[i, 1] * STEP
        y, psi = y + v * STEP, psi + rate * STEP
    sampled = found[::STRIDE]
    return Swaying(sampled[:, 0], sampled[:, 1], np.full(len(sampled), speed))
