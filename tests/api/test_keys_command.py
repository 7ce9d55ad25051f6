"""``treadwatch keys``: the first key needs none."""

from __future__ import annotations

import json
import re
from pathlib import Path

from in_process_command import Run

from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.stores.access import AuditFilter


def test_keys_are_made_listed_and_revoked_in_the_database(treadwatch: Run, tmp_path: Path) -> None:
    registry = tmp_path / "registry.json"
    registry.write_text(json.dumps({"format": "treadwatch-registry-1", "fleets": [{"code": "alpha", "name": "Alpha"}]}))
    assert treadwatch("db", "upgrade", data_dir=str(tmp_path / "data")).returncode == 0
    assert treadwatch("registry", "load", str(registry)).returncode == 0
    made = treadwatch("keys", "create", "--owner", "depot", "--scope", "read", "--scope", "act", "--fleet", "alpha")
    secret = made.stdout.strip()
    assert re.fullmatch(r"tw_[a-z2-7]{8}_[A-Za-z0-9_-]{43}", secret)
    assert secret not in made.stderr
    listed = treadwatch("keys", "list").stdout
    prefix = secret.split("_")[1]
    assert re.search(rf"^{prefix} +depot +act,read +alpha +\S+ +never +never +usable", listed, re.MULTILINE)
    assert secret[-43:] not in listed
    assert prefix in treadwatch("keys", "revoke", prefix).stdout
    assert re.search(rf"^{prefix} .* revoked", treadwatch("keys", "list").stdout, re.MULTILINE)
    engine = database_engine(f"sqlite:///{tmp_path / 'data' / 'treadwatch.sqlite'}")
    with SqlStorage(engine, tmp_path / "data").read() as unit:
        assert [entry.path for entry in unit.audit.page(AuditFilter(), None, 10)] == ["revoke", "create"]
    engine.dispose()


def test_a_key_that_makes_no_sense_is_one_line_and_exit_2(treadwatch: Run, tmp_path: Path) -> None:
    treadwatch("db", "upgrade", data_dir=str(tmp_path))
    for arguments, why in (
        (["--scope", "read"], "say which fleets"),
        (["--scope", "read", "--all-fleets", "--fleet", "alpha"], "say which fleets"),
        (["--scope", "root", "--all-fleets"], "must be some of act, admin, ingest, read"),
        (["--scope", "read", "--fleet", "nowhere"], "no fleet 'nowhere'"),
        (["--scope", "read", "--all-fleets", "--days", "0"], "must be above 0"),
    ):
        refused = treadwatch("keys", "create", "--owner", "x", *arguments)
        assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
        assert why in refused.stderr
    unknown = treadwatch("keys", "revoke", "aaaaaaaa")
    assert (unknown.returncode, unknown.stderr.strip()) == (2, "treadwatch: no key 'aaaaaaaa'")


def test_open_access_beyond_loopback_ends_with_one_line(treadwatch: Run, tmp_path: Path) -> None:
    treadwatch("db", "upgrade", data_dir=str(tmp_path))
    refused = treadwatch("serve", "--host", "0.0.0.0", access="open")  # noqa: S104 - what is refused
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
    assert "open to everyone who reaches this address" in refused.stderr
