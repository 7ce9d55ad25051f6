"""A poller whose cursor is newer than the database: it is refused and shown where to go on, and misses nothing."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import api_fleet
import httpx
import populated_fleet
import pytest
from running_service import running
from stored_raw import installation, raw_of

from api import cursors
from api.factory import open_store
from api.settings import Settings
from fleet_db.keeping.backup import back_up
from fleet_db.keeping.restore import restore
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage

KIND = "wheel_asymmetry"


def settings_of(folder: Path) -> Settings:
    return Settings.model_validate({"data_dir": folder, "port": 0})


def quietly(_done: int, _total: int) -> None:
    """Report to nobody."""


@contextmanager
def opened(folder: Path) -> Iterator[SqlStorage]:
    folder.mkdir(exist_ok=True)
    upgrade(settings_of(folder).url)
    with closing(open_store(settings_of(folder))) as storage:
        yield storage


class Poller:
    """A client of the feed of one folder's database."""

    def __init__(self, url: str) -> None:
        self.url = url

    def ask(self, after: str | None, **more: str) -> httpx.Response:
        params = more if after is None else {"after": after, **more}
        return httpx.get(f"{self.url}/v1/alerts/feed", params=params, timeout=30)

    def poll(self, after: str | None, **more: str) -> tuple[list[int], str]:
        response = self.ask(after, **more)
        assert response.status_code == 200, response.text
        body = response.json()
        return [item["alert"]["id"] for item in body["items"]], body["next_cursor"]

    def refused(self, after: str) -> Any:  # noqa: ANN401 - JSON
        response = self.ask(after)
        assert response.status_code == 409, response.text
        body = response.json()
        assert body["type"] == "urn:treadwatch:problem:cursor-of-another-database"
        return body

    def follow(self, path: str) -> list[int]:
        return [item["alert"]["id"] for item in httpx.get(self.url + path, timeout=30).json()["items"]]


Polling = Callable[[str], Poller]


@pytest.fixture
def original(tmp_path: Path) -> Iterator[SqlStorage]:
    with opened(tmp_path / "original") as storage:
        populated_fleet.populate(storage)
        yield storage


@pytest.fixture
def polling(tmp_path: Path) -> Iterator[Polling]:
    with ExitStack() as stack:
        yield lambda folder: Poller(stack.enter_context(running(settings_of(tmp_path / folder))))


def test_a_poller_that_is_ahead_of_a_restored_database_is_shown_where_to_go_on(
    original: SqlStorage, polling: Polling, tmp_path: Path
) -> None:  # fmt: skip
    before = polling("original")
    _, first = before.poll(None, limit="1")
    _, at_backup = before.poll(None)
    back_up(original, raw_of(original), tmp_path / "backups", 1, progress=quietly)
    lost = api_fleet.raised(original, "WS-020", KIND)
    news, newer = before.poll(at_backup)
    assert news == [lost.alert_id]

    restored = tmp_path / "restored"
    restore(installation(settings_of(restored).url, restored), tmp_path / "backups", progress=quietly)
    with opened(restored) as storage:
        after = polling("restored")
        body = after.refused(newer)  # nothing new yet, and its event is not there
        news = [api_fleet.raised(storage, wheelset, KIND).alert_id for wheelset in ("WS-021", "WS-022", "WS-023")]
        assert after.refused(newer)["next_cursor"] == body["next_cursor"]  # now there is another event of its number
        assert after.follow(body["next"]) == news
        assert after.poll(body["next_cursor"])[0] == news
        assert after.poll(at_backup)[0] == news  # up to the backup the history is the same
        assert after.poll(first)[0][-3:] == news
        _, cursor = after.poll(at_backup)
        before.refused(cursor)  # the other way round as well


def test_a_database_that_was_restored_by_hand_is_found_out_too(
    original: SqlStorage, polling: Polling, tmp_path: Path
) -> None:
    before = polling("original")
    _, at_copy = before.poll(None)
    with original.write():  # nobody writes meanwhile
        shutil.copytree(tmp_path / "original", tmp_path / "copy")
    api_fleet.raised(original, "WS-020", KIND)
    _, newer = before.poll(at_copy)
    with opened(tmp_path / "copy") as storage:
        after = polling("copy")
        assert after.refused(newer)["next"] == "/v1/alerts/feed"
        other = api_fleet.raised(storage, "WS-021", KIND)
        further = api_fleet.raised(storage, "WS-022", KIND)
        body = after.refused(newer)
        assert "next_cursor" not in body
        assert after.follow(body["next"])[-2:] == [other.alert_id, further.alert_id]
        assert after.poll(at_copy)[0] == [other.alert_id, further.alert_id]


def test_a_cursor_of_another_installation_is_refused(original: SqlStorage, polling: Polling, tmp_path: Path) -> None:
    with opened(tmp_path / "other") as other:
        populated_fleet.populate(other)
        _, cursor = polling("other").poll(None)
    assert "another database" in polling("original").refused(cursor)["detail"]
    with original.read() as unit:
        assert len(unit.feed_branches.all()) == 1


def test_what_is_no_cursor_of_the_feed_is_refused(original: SqlStorage, polling: Polling) -> None:
    with original.read() as unit:
        newest = unit.feed_branches.newest_sequence()
    for key in (newest, -1, "1.x.y"):
        assert polling("original").ask(cursors.encode("poll_alert_feed", {}, key)).status_code == 400
