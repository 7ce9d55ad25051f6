"""Who is left out of the friction of a section: in the store and in the answer."""

from __future__ import annotations

from api.routes.opinions import section_adhesion
from estimation.values.opinions import LeftOut, SectionAdhesion
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.packed_values import pack_value, unpack_value

WHY = Reason(ReasonCode.FRICTION_DIFFERS, "vehicle V shows 2.00 times the 1/friction of the other vehicles")


def test_vehicles_and_wheelsets_that_are_left_out_are_stored_and_answered() -> None:
    found = SectionAdhesion("S", 0, 1, 8, (), (), (LeftOut("V", None, WHY), LeftOut("U", "U-1", WHY)))
    stored = unpack_value(SectionAdhesion, pack_value(found), where="here")
    assert stored == found
    answer = section_adhesion(stored).left_out
    assert [(one.vehicle, one.wheelset) for one in answer] == [("V", None), ("U", "U-1")]
    assert {(one.reason, one.reason_code) for one in answer} == {(WHY.text, ReasonCode.FRICTION_DIFFERS)}
