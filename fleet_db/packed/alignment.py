"""The arrays of a track alignment packed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.values.json_value import JsonValue
from estimation.values.quantities import Status
from estimation.values.track import RECORDED, GaugeShift, TrackAlignment, TrackFindings
from fleet_db.packed.numbers import number_to_json, real_from_json
from fleet_db.packing import pack, unpack

KIND = "track_alignment"
VERSION = 2
OF_RECORDINGS = 1  # says nothing of source, cut-off, scale and gauge: all of it is known
OF_RECORDING = (RECORDED, np.inf, 0, True)
ARRAYS = ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")


def pack_alignment(alignment: TrackAlignment) -> bytes:
    """Return ``alignment`` as one blob, without its version, so that the same content is the same blob."""
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(alignment, name) for name in ARRAYS}
    scalars: dict[str, JsonValue] = {"section": alignment.section, "status": str(alignment.status)}
    whole = (alignment.source, alignment.cutoff_wavelength, alignment.scale_std, alignment.gauge_known) == OF_RECORDING
    if whole and alignment.findings is None:
        return pack(KIND, OF_RECORDINGS, scalars, arrays)
    told: dict[str, JsonValue] = {
        "source": alignment.source,
        "cut_off": number_to_json(alignment.cutoff_wavelength),
        "scale_std": number_to_json(alignment.scale_std),
        "gauge_known": alignment.gauge_known,
    }
    if alignment.findings is not None:
        told["findings"], more = _findings_apart(alignment.findings)
        arrays |= more
    return pack(KIND, VERSION, scalars | told, arrays)


def unpack_alignment(blob: bytes, version: int, *, where: str) -> TrackAlignment:
    """Return the alignment as ``version``, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    scalars = packed.scalars
    arrays: dict[str, Any] = {name: packed.arrays[name] for name in ARRAYS}
    found = TrackAlignment(section=scalars["section"], version=version, status=Status(scalars["status"]), **arrays)
    if packed.version == OF_RECORDINGS:
        return found
    return replace(
        found,
        source=scalars["source"],
        cutoff_wavelength=real_from_json(scalars["cut_off"]),
        scale_std=real_from_json(scalars["scale_std"]),
        gauge_known=scalars["gauge_known"],
        findings=_findings(scalars["findings"], packed.arrays) if "findings" in scalars else None,
    )


def _findings_apart(findings: TrackFindings) -> tuple[JsonValue, dict[str, npt.NDArray[Any]]]:
    """Return findings as JSON and arrays: the grids of what gauge does, and (wheelset, r, e) what it does."""
    names = sorted(findings.gauge_shifts)
    told: JsonValue = {
        "stiffness_ratio": {name: number_to_json(value) for name, value in sorted(findings.stiffness_ratio.items())},
        "stiffness_ratio_std": number_to_json(findings.stiffness_ratio_std),
        "gauge_shifts": list[JsonValue](names),
    }
    if not names:
        return told, {}
    shifts = [findings.gauge_shifts[name] for name in names]
    return told, {
        "shift_difference": np.stack([one.difference for one in shifts]),
        "shift_gauge": np.stack([one.gauge for one in shifts]),
        "shift": np.stack([one.shift for one in shifts]),
    }


def _findings(told: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> TrackFindings:
    return TrackFindings(
        stiffness_ratio={name: real_from_json(value) for name, value in told["stiffness_ratio"].items()},
        stiffness_ratio_std=real_from_json(told["stiffness_ratio_std"]),
        gauge_shifts={
            name: GaugeShift(arrays["shift_difference"][k], arrays["shift_gauge"][k], arrays["shift"][k])
            for k, name in enumerate(told["gauge_shifts"])
        },
    )
