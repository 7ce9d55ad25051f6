"""``treadwatch webhooks``: in the database itself, with a real receiver."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from in_process_command import Run
from webhook_receiver import Answer, receiving

from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.stores.access import AuditFilter


def test_webhooks_are_made_tried_moved_and_deleted(
    treadwatch: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert treadwatch("db", "upgrade", data_dir=str(tmp_path)).returncode == 0
    monkeypatch.setenv("TREADWATCH_WEBHOOK_NETWORKS", "127.0.0.0/8")
    with receiving() as receiver:
        made = treadwatch("webhooks", "add", receiver.url, "--severity", "critical", "--description", "work orders")
        assert re.fullmatch(r"whsec_[A-Za-z0-9+/=]{44}", made.stdout.strip())
        secret = made.stdout.strip()
        assert "webhook 1;" in made.stderr
        tried = treadwatch("webhooks", "test", "1")
        assert (tried.returncode, tried.stdout[:22]) == (0, "webhook 1: taken (204)")
        assert json.loads(receiver.received[0].body)["type"] == "treadwatch.webhook.test"
        receiver.answer = Answer(410)
        refused = treadwatch("webhooks", "test", "1")
        assert (refused.returncode, "410" in refused.stdout) == (1, True)
        listed = treadwatch("webhooks", "list").stdout
        assert re.search(rf"^1 +active +\S+Z +{re.escape(receiver.url)} +work orders$", listed, re.MULTILINE)
        assert secret not in listed
    for command, said in (
        (["pause", "1"], "webhook 1 is paused"),
        (["activate", "1"], "webhook 1 is active"),
        (["replay", "1", "--from", "2026-01-01T00:00:00Z"], "webhook 1 goes on behind event 0"),
        (["delete", "1"], "webhook 1 is deleted"),
    ):
        assert treadwatch("webhooks", *command).stdout.strip() == said
    engine = database_engine(f"sqlite:///{tmp_path / 'treadwatch.sqlite'}")
    with SqlStorage(engine, tmp_path).read() as unit:
        done = [(entry.path, entry.object) for entry in unit.audit.page(AuditFilter(), None, 10)]
    engine.dispose()
    assert done == [(what, "/v1/webhooks/1") for what in ("delete", "replay", "activate", "pause", "add")]


def test_what_cannot_be_is_one_line_and_exit_2(
    treadwatch: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    treadwatch("db", "upgrade", data_dir=str(tmp_path))
    monkeypatch.setenv("TREADWATCH_WEBHOOK_NETWORKS", "127.0.0.0/8")
    for arguments, why in (
        (["add", "https://10.0.0.1/"], "not public"),
        (["add", "https://user:geheim@127.0.0.1/"], "carries a user"),
        (["add", "http://127.0.0.1/", "--kind", "x"], "'x' is none of"),
        (["add", "http://127.0.0.1/", "--severity", "x"], "'x' is none of"),
        (["add", "http://127.0.0.1/", "--fleet", "x"], "no fleet 'x'"),
        (["replay", "1"], "either --after or --from"),
        (["replay", "1", "--from", "soon"], "RFC 3339"),
        (["replay", "1", "--after", "nonsense"], "no webhook '1'"),
        (["test", "7"], "no webhook '7'"),
    ):
        refused = treadwatch("webhooks", *arguments)
        assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1), refused
        assert why in refused.stderr
        assert "geheim" not in refused.stderr
    monkeypatch.setenv("TREADWATCH_WEBHOOK_NETWORKS", "the office")
    refused = treadwatch("webhooks", "add", "https://127.0.0.1/")
    assert (refused.returncode, "TREADWATCH_WEBHOOK_NETWORKS" in refused.stderr) == (2, True)
