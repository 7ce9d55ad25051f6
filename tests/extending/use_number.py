"""The number of the page is served with a geometry, and named in the document of the API."""

from __future__ import annotations

import math

from wheelset_life import geometry_record

import estimation
from api.app import document_text
from api.schemas.geometry import geometry
from estimation.values.reasons import Reason, ReasonCode

record = geometry_record("W1", None, 20, 0.2)
served = geometry(record).model_dump()["greatest_radius_difference_mm"]
assert math.isclose(abs(served["value"]), 2 * 0.2 * 3.75), served
assert math.isclose(served["std"], 0.02), served
unknown = record.geometry.mismatched(Reason(ReasonCode.ROLLING_RADIUS_DIFFERS, "another radius"))
assert unknown.greatest_difference.reason == unknown.reason
assert '"greatest_radius_difference_mm"' in document_text()
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
