"""What the digests of results compare."""

from __future__ import annotations

from bench.digests import differences


def test_a_changed_number_a_lost_key_and_a_changed_state_are_reported_with_their_path() -> None:
    expected = {"a": [1.0, 2.0], "b": "estimated", "c": 3}
    assert list(differences(expected, expected)) == []
    assert list(differences(expected, {"a": [1.0, 2.0 + 1e-8], "b": "estimated", "c": 3}, relative=1e-7)) == []
    found = list(differences(expected, {"a": [1.0, 2.002], "b": "refused"}, relative=1e-7))
    assert [line.partition(":")[0] for line in found] == ["/a/1", "/b", "/c"]
    assert "relative difference 1.0e-03" in found[0]
