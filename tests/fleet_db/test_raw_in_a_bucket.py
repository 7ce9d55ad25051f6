"""A bucket that is away, refuses, is slow or damages: nothing is half-stored, and it is said where and why."""

from __future__ import annotations

import hashlib
import signal
import socket
import subprocess
import sys
import time
import traceback
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest
from raw_stores import KEYS, in_bucket
from s3_in_the_way import careless_store, line
from s3_server import BUCKET, SECRET_KEY, S3Server, running_s3_server
from scipy.stats import uniform

from estimation.errors import PassingFaultError
from fleet_db.raw import LostRecordingError, RawStore, RawTotal
from fleet_db.s3_bucket import PART_BYTES, RETRIES, S3Place

NEEDLE = b"one of the bytes changes" * 4
LARGE = uniform.rvs(size=2 * PART_BYTES // 8, random_state=2).tobytes() + NEEDLE
ABSENT = "a" * 64


def prefix() -> str:
    return uuid.uuid4().hex


def uses(raw: RawStore, folder: Path) -> list[tuple[str, Callable[[], object]]]:
    """Return everything that asks a store."""
    source = folder / "source.blf"
    source.write_bytes(b"frames")
    return [
        ("put", lambda: raw.put_bytes(b"frames", ".blf")),
        ("put a file", lambda: raw.put_file(source)),
        ("read", lambda: raw.fault(ABSENT, ".blf")),
        ("open", lambda: raw.whole(ABSENT, ".blf", 6).__enter__()),
        ("size", lambda: raw.size(ABSENT, ".blf")),
        ("list", lambda: list(raw.listed())),
        ("total", lambda: raw.total(10)),
        ("read the mark", raw.read_mark),
        ("write the mark", lambda: raw.write_mark("f00d")),
    ]


def refusal(use: Callable[[], object]) -> PassingFaultError:
    """Return why a store cannot be used, having looked that no secret is in it and that nothing counts as lost."""
    with pytest.raises(PassingFaultError) as caught:
        use()
    assert not isinstance(caught.value, LostRecordingError)
    shown = "".join(traceback.format_exception(caught.value))
    assert SECRET_KEY not in shown
    assert "of-nobody" not in shown
    assert caught.value.code == "waits_for_storage"
    return caught.value


def test_a_server_that_stops_and_comes_back(tmp_path: Path) -> None:
    with running_s3_server() as server:
        behind = in_bucket(server, "raw", tmp_path)
        raw, place = behind.store, f"s3://{BUCKET}/raw"
        digest = raw.put_bytes(b"before", ".blf")
        server.stop()
        for name, use in uses(raw, tmp_path):
            fault = refusal(use)
            assert fault.file is not None, name
            assert fault.file.startswith(place)
            assert fault.reason == f"{server.endpoint} cannot be reached"
        assert not raw.lost(digest, ".blf")  # nothing is known of it
        assert behind.left() == []
        server.start()
        assert raw.fault(digest, ".blf") is None
        assert behind.content(raw.put_bytes(b"after", ".blf"), ".blf") == b"after"


def test_wrong_keys_are_refused_and_not_shown(s3_server: S3Server, tmp_path: Path) -> None:
    wrong = in_bucket(s3_server, prefix(), tmp_path, keys=KEYS | {"secret_access_key": "of-nobody"})
    for name, use in uses(wrong.store, tmp_path):
        reason = refusal(use).reason
        assert reason.startswith(f"{s3_server.endpoint} answers 403 Forbidden"), name
    assert wrong.names() == []
    place = S3Place("b", "p", "https://x", "r", allow_http=False, timeout_s=1.0, keys=KEYS)
    assert SECRET_KEY not in repr(place)
    assert SECRET_KEY not in repr(wrong.store)


def test_a_bucket_that_is_not_there_is_no_loss_of_what_should_be_in_it(s3_server: S3Server, tmp_path: Path) -> None:
    raw = in_bucket(s3_server, prefix(), tmp_path, bucket="no-such-bucket").store
    for name, use in uses(raw, tmp_path):
        assert "404 Not Found (NoSuchBucket)" in refusal(use).reason, name


def test_a_store_that_is_too_busy_is_asked_a_few_times(s3_server: S3Server, tmp_path: Path) -> None:
    with careless_store(status=503) as busy:
        raw = in_bucket(s3_server, prefix(), tmp_path, endpoint=busy.endpoint).store
        assert refusal(raw.read_mark).reason == f"{busy.endpoint} answers 503 Service Unavailable (SlowDown)"
        assert busy.requests == ["GET"] * (1 + RETRIES)


def test_a_store_that_says_nothing_is_given_up(s3_server: S3Server, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        endpoint = f"http://127.0.0.1:{silent.getsockname()[1]}"
        raw = in_bucket(s3_server, prefix(), tmp_path, endpoint=endpoint, timeout_s=0.3).store
        for _, use in uses(raw, tmp_path):
            assert refusal(use).reason == f"{endpoint} does not answer within 0.3 s"


@pytest.mark.parametrize("content", [NEEDLE * 100, LARGE], ids=["small", "large"])
def test_bytes_that_change_on_the_way_are_refused_by_the_store(
    s3_server: S3Server, tmp_path: Path, content: bytes
) -> None:
    def change(piece: bytes) -> bytes:
        return piece.replace(NEEDLE, NEEDLE[:-1] + b"S")

    with line(s3_server.ports["s3.port"], change=change) as bad:
        behind = in_bucket(s3_server, prefix(), tmp_path, endpoint=bad.endpoint)
        assert "400 Bad Request (BadDigest)" in refusal(lambda: behind.store.put_bytes(content, ".blf")).reason
    assert (behind.names(), behind.left()) == ([], [])


def test_what_a_careless_store_damages_is_not_called_stored(s3_server: S3Server, tmp_path: Path) -> None:
    with careless_store(keep=lambda content: content.replace(b"right", b"wrong")) as store:
        raw = in_bucket(s3_server, prefix(), tmp_path, endpoint=store.endpoint).store
        fault = refusal(lambda: raw.put_bytes(b"all right", ".blf"))
        assert fault.reason == "was sent, and is damaged: its content has another digest"
        store.keep = lambda content: content[:-1]
        assert refusal(lambda: raw.put_bytes(b"all right", ".blf")).reason == "was sent, and has 8 bytes, not 9"
        store.keep = lambda content: content
        digest = raw.put_bytes(b"all right", ".blf")
        assert [content for path, content in store.kept.items() if digest in path] == [b"all right"]


def test_where_the_etag_says_nothing_the_object_is_read_back(s3_server: S3Server, tmp_path: Path) -> None:
    """As of a bucket that encrypts with keys of a key service."""
    with careless_store(tag=lambda content: hashlib.sha1(content, usedforsecurity=False).hexdigest()) as store:
        raw = in_bucket(s3_server, prefix(), tmp_path, endpoint=store.endpoint).store
        raw.put_bytes(b"encrypted", ".blf")
        assert store.requests == ["HEAD", "PUT", "HEAD", "HEAD", "GET"]
        store.requests.clear()
        store.tag = lambda content: hashlib.md5(content, usedforsecurity=False).hexdigest()
        raw.put_bytes(b"in plain", ".blf")
        assert store.requests == ["HEAD", "PUT", "HEAD"]


def test_an_object_that_is_replaced_while_it_is_read_is_no_loss(s3_server: S3Server, tmp_path: Path) -> None:
    behind = in_bucket(s3_server, prefix(), tmp_path)
    digest = behind.store.put_bytes(LARGE, ".blf")
    reading = behind.store._checked(digest, ".blf", len(LARGE))
    next(reading)
    behind.write(digest, ".blf", LARGE[::-1])
    assert "412 Precondition Failed" in refusal(lambda: list(reading)).reason


def test_no_variable_of_the_environment_leads_elsewhere(
    s3_server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name_of_it = prefix()
    objects = s3_server.objects(name_of_it)
    for name, value in {
        "AWS_ENDPOINT_URL": "http://127.0.0.1:9",
        "AWS_ENDPOINT_URL_S3": "http://127.0.0.1:9",
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "of-nobody",
        "AWS_SESSION_TOKEN": "",
        "AWS_REGION": "mars-north-1",
        "AWS_SKIP_SIGNATURE": "true",
        "AWS_VIRTUAL_HOSTED_STYLE_REQUEST": "true",
        "AWS_BUCKET": "another",
    }.items():
        monkeypatch.setenv(name, value)
    digest = in_bucket(s3_server, name_of_it, tmp_path).store.put_bytes(b"here", ".blf")
    assert [meta["path"] for page in objects.list() for meta in page] == [f"{digest[:2]}/{digest}.blf"]


def test_objects_of_others_below_the_prefix_are_left_alone(s3_server: S3Server, tmp_path: Path) -> None:
    behind = in_bucket(s3_server, prefix(), tmp_path)
    digest = behind.store.put_bytes(b"ours", ".blf")
    for name in ("notes.txt", ".hidden", f"zz/{digest}.blf", f"{'b' * 64}.blf", f"copy/{digest[:2]}/{digest}.blf"):
        behind.objects.put(name, b"of others")
    assert [item.digest for item in behind.store.listed()] == [digest]
    assert behind.store.total(10) == RawTotal(1, 4, estimated=False)


PUTTING = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from raw_stores import KEYS
from fleet_db.raw_s3 import S3RawStore
from fleet_db.s3_bucket import S3Bucket, S3Place
place = S3Place(sys.argv[2], sys.argv[3], sys.argv[4], "us-east-1", True, 60.0, KEYS)
S3RawStore(S3Bucket(place), Path(sys.argv[5])).put_file(Path(sys.argv[6]))
"""


def test_a_process_that_is_killed_leaves_no_part_of_a_recording(s3_server: S3Server, tmp_path: Path) -> None:
    behind = in_bucket(s3_server, prefix(), tmp_path)
    source = tmp_path / "large.blf"
    source.write_bytes(LARGE)
    tests = str(Path(__file__).parents[1])
    with line(s3_server.ports["s3.port"], most_bytes=PART_BYTES * 1.5) as slow:
        where = [BUCKET, behind.store.url.rpartition("/")[2], slow.endpoint, str(behind.store.receiving), str(source)]
        process = subprocess.Popen([sys.executable, "-c", PUTTING, tests, *where])
        assert slow.held.wait(60.0)  # one part is there, and not all
        process.send_signal(signal.SIGKILL)
        process.wait(120)
    assert behind.names() == []
    (left,) = behind.left()
    (item,) = behind.store.listed()
    assert (Path(item.place).name, item.digest, item.size_bytes) == (left, "", len(LARGE))
    time.sleep(0.01)
    assert behind.store.remove_old(item, 0.0) == len(LARGE)  # as a purge does
    assert behind.store.put_file(source) == hashlib.sha256(LARGE).hexdigest()
