"""From settings and environment to the store of raw recordings: what is refused, and what is never shown."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from api.bucket import bucket_store
from api.factory import raw_store
from api.settings import Settings, load_settings
from estimation.errors import ParameterError, PassingFaultError
from fleet_db.raw import FileRawStore
from fleet_db.raw_s3 import S3RawStore
from fleet_db.s3_bucket import S3Place

KEYS = {"AWS_ACCESS_KEY_ID": "AKIAEXAMPLE", "AWS_SECRET_ACCESS_KEY": "the/secret"}
BUCKET: dict[str, Any] = {"raw_store": "s3://fleet/raw/north/"}


def place_of(environment: dict[str, str] | None = None, **changed: object) -> S3Place:
    """Return where a bucket is by settings and environment."""
    settings = Settings(**(BUCKET | changed), _env_file=None)  # type: ignore[call-arg, arg-type]
    store = bucket_store(settings, KEYS if environment is None else environment)
    assert isinstance(store, S3RawStore)
    assert store.receiving == settings.data_dir / "receiving"
    return store._bucket.place


def test_left_out_it_is_a_folder_beside_the_windows(tmp_path: Path) -> None:
    store = raw_store(Settings(data_dir=tmp_path, _env_file=None))
    assert isinstance(store, FileRawStore)
    assert store.directory == tmp_path / "raw"


def test_a_file_url_is_a_folder_anywhere() -> None:
    settings = Settings(raw_store="file:///srv/raw%20recordings", _env_file=None)
    store = raw_store(settings)
    assert isinstance(store, FileRawStore)
    assert store.directory == Path("/srv/raw recordings")


def test_a_bucket_is_that_of_aws_unless_an_endpoint_is_given() -> None:
    place = place_of()
    assert (place.bucket, place.prefix, place.url) == ("fleet", "raw/north", "s3://fleet/raw/north")
    assert (place.endpoint, place.region, place.allow_http) == (
        "https://s3.us-east-1.amazonaws.com",
        "us-east-1",
        False,
    )
    assert place.keys == {"access_key_id": "AKIAEXAMPLE", "secret_access_key": "the/secret"}
    assert place_of(KEYS | {"AWS_REGION": "eu-north-1"}).endpoint == "https://s3.eu-north-1.amazonaws.com"
    assert place_of(KEYS | {"AWS_REGION": "eu-north-1"}, s3_region="eu-west-1").region == "eu-west-1"
    assert place_of(s3_endpoint="https://minio.depot:9000/").endpoint == "https://minio.depot:9000"
    assert place_of(KEYS | {"AWS_SESSION_TOKEN": "t"}).keys == {
        "access_key_id": "AKIAEXAMPLE",
        "secret_access_key": "the/secret",
        "token": "t",
    }


def test_without_tls_only_this_machine_or_with_leave() -> None:
    for here in ("http://127.0.0.1:9000", "http://localhost:9000", "http://[::1]:9000"):
        assert place_of(s3_endpoint=here).allow_http
    with pytest.raises(ParameterError, match="without TLS") as caught:
        place_of(s3_endpoint="http://minio.depot:9000")
    assert caught.value.field == "TREADWATCH_S3_ENDPOINT"
    assert place_of(s3_endpoint="http://minio.depot:9000", s3_allow_http=True).allow_http
    assert not place_of(s3_allow_http=True).allow_http


@pytest.mark.parametrize(
    ("environment", "field"),
    [
        ({}, "AWS_ACCESS_KEY_ID"),
        ({"AWS_ACCESS_KEY_ID": "", "AWS_SECRET_ACCESS_KEY": ""}, "AWS_ACCESS_KEY_ID"),
        ({"AWS_SECRET_ACCESS_KEY": "the/secret"}, "AWS_ACCESS_KEY_ID"),
        ({"AWS_ACCESS_KEY_ID": "AKIAEXAMPLE"}, "AWS_SECRET_ACCESS_KEY"),
        ({"AWS_ACCESS_KEY_ID": "AKIAEXAMPLE", "AWS_WEB_IDENTITY_TOKEN_FILE": "/t"}, "AWS_SECRET_ACCESS_KEY"),
    ],
)
def test_missing_credentials_are_named(environment: dict[str, str], field: str) -> None:
    with pytest.raises(ParameterError) as caught:
        place_of(environment)
    assert caught.value.field == field
    assert "the/secret" not in str(caught.value)


def test_a_role_gives_credentials_where_no_keys_are() -> None:
    assert place_of({"AWS_ROLE_ARN": "arn:x", "AWS_WEB_IDENTITY_TOKEN_FILE": "/var/run/token"}).keys is None
    assert place_of({"AWS_CONTAINER_CREDENTIALS_RELATIVE_URI": "/v2/x"}).keys is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("raw_store", "raw"),
        ("raw_store", "/srv/raw"),
        ("raw_store", "file://host/raw"),
        ("raw_store", "file:///"),
        ("raw_store", "file:///raw?x=1"),
        ("raw_store", "s3://"),
        ("raw_store", "s3:///raw"),
        ("raw_store", "s3://KEY:SECRET@fleet/raw"),
        ("raw_store", "https://fleet.s3.amazonaws.com"),
        ("s3_endpoint", "minio:9000"),
        ("s3_endpoint", "https://KEY:SECRET@minio"),
        ("s3_endpoint", "https://minio/fleet"),
        ("s3_endpoint", "ftp://minio"),
        ("s3_timeout_s", "0"),
    ],
)
def test_what_names_no_store_is_refused_by_its_variable_and_not_repeated(name: str, value: str) -> None:
    with pytest.raises(ParameterError) as caught:
        load_settings(**{name: value})
    assert caught.value.field == f"TREADWATCH_{name.upper()}"
    assert "SECRET" not in str(caught.value)


def test_a_bucket_without_its_extra_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(PassingFaultError, match=r"pip install 'treadwatch\[s3\]'") as caught:
        place_of()
    assert caught.value.code == "waits_for_extra"
