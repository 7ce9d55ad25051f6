"""From the settings to a bucket of raw recordings, with the credentials of the environment."""

from __future__ import annotations

import os
from collections.abc import Mapping
from urllib.parse import urlsplit

from api.settings import LOOPBACK, PREFIX, Settings
from estimation.errors import ParameterError
from fleet_db.raw_s3 import S3RawStore
from fleet_db.s3_bucket import S3Bucket, S3Place

DEFAULT_REGION = "us-east-1"
KEY_ID, SECRET, TOKEN = "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN"
BY_ROLE = (
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
"""Variables with which the client library gets credentials that end and are renewed."""


def bucket_store(settings: Settings, environment: Mapping[str, str] = os.environ) -> S3RawStore:
    """Return the bucket that the settings name; it is not asked yet, but its credentials must be there."""
    parts = urlsplit(settings.raw_store or "")
    region = settings.s3_region or environment.get("AWS_REGION") or environment.get("AWS_DEFAULT_REGION")
    place = S3Place(
        bucket=parts.netloc,
        prefix=parts.path.strip("/"),
        endpoint=_endpoint(settings, region or DEFAULT_REGION),
        region=region or DEFAULT_REGION,
        allow_http=settings.s3_endpoint is not None and settings.s3_endpoint.startswith("http://"),
        timeout_s=settings.s3_timeout_s,
        keys=_keys(environment),
    )
    return S3RawStore(S3Bucket(place), settings.receiving_dir)


def _endpoint(settings: Settings, region: str) -> str:
    if settings.s3_endpoint is None:
        return f"https://s3.{region}.amazonaws.com"
    here = urlsplit(settings.s3_endpoint).hostname in LOOPBACK
    if settings.s3_endpoint.startswith("http://") and not (here or settings.s3_allow_http):
        reason = f"must be https://, or {PREFIX}S3_ALLOW_HTTP=true: without TLS others read and change recordings"
        raise ParameterError(reason, field=f"{PREFIX}S3_ENDPOINT")
    return settings.s3_endpoint.rstrip("/")


def _keys(environment: Mapping[str, str]) -> dict[str, str] | None:
    """Return the keys of the environment, an empty variable being none; None where a role gives them."""
    given = {name: environment.get(name, "") for name in (KEY_ID, SECRET, TOKEN)}
    if given[KEY_ID] and given[SECRET]:
        keys = {"access_key_id": given[KEY_ID], "secret_access_key": given[SECRET]}
        return keys | ({"token": given[TOKEN]} if given[TOKEN] else {})
    if not (given[KEY_ID] or given[SECRET]) and any(environment.get(name) for name in BY_ROLE):
        return None
    missing = SECRET if given[KEY_ID] else KEY_ID
    raise ParameterError(f"is not set, and {PREFIX}RAW_STORE is a bucket", field=missing)
