"""Representations are kept while their version stands, up to a size."""

from __future__ import annotations

from api.answers import RepresentationCache


def test_a_representation_is_made_once_a_version() -> None:
    cache, made = RepresentationCache(), []

    def make(version: int) -> bytes:
        made.append(version)
        return b"%d" % version

    assert [cache.get_or_make(("trend", 1), lambda: make(1)) for _ in range(3)] == [b"1"] * 3
    assert cache.get_or_make(("trend", 2), lambda: make(2)) == b"2"
    assert made == [1, 2]


def test_the_least_recently_used_is_displaced_first_and_the_size_is_bounded() -> None:
    cache, made = RepresentationCache(limit_bytes=10), []

    def of(key: str, size: int = 4) -> bytes:
        return cache.get_or_make(key, lambda: made.append(key) or b"x" * size)

    of("a"), of("b"), of("a"), of("c")
    assert made == ["a", "b", "c"]
    of("a")
    assert made == ["a", "b", "c"]
    of("b")
    assert made == ["a", "b", "c", "b"]
    of("large", 11)
    of("large", 11)
    assert made[-2:] == ["large", "large"]
