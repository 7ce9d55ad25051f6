"""What a deployment may set, from the environment (``TREADWATCH_...``) or a ``.env`` file."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar
from urllib.parse import quote, urlsplit

from pydantic import AfterValidator, Field, ValidationError, create_model, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from estimation.errors import ParameterError
from estimation.rails.parameters import RailsParameters
from estimation.values.units import SECOND_NS
from fleet_db.keeping.retention import Kept, Retention
from ingest.input_file import InputTable, read_toml


def names_store(url: str) -> bool:
    """Return whether a URL is ``file:///absolute/path`` or ``s3://bucket/prefix``."""
    parts = urlsplit(url)
    if parts.query or parts.fragment or "@" in parts.netloc:
        return False
    if parts.scheme == "file":
        return not parts.netloc and len(parts.path) > 1
    return parts.scheme == "s3" and bool(parts.netloc)


def names_endpoint(url: str) -> bool:
    """Return whether a URL is ``https://host:port`` or ``http://host:port``."""
    parts = urlsplit(url)
    plain = "@" not in parts.netloc and not parts.path.strip("/") and not parts.query and not parts.fragment
    return parts.scheme in {"http", "https"} and bool(parts.hostname) and plain


def known_sections(text: str) -> list[tuple[str, int]]:
    """Return codes of sections, each with the begin of its day, ns UTC, of a text ``S1@2026-03-01,S2@2026-05-17``."""
    dated = []
    for entry in filter(None, (item.strip() for item in text.split(","))):
        code, at, day = entry.rpartition("@")
        if not at or not code:
            raise ValueError(
                "must be codes of sections, each with the day for which its rails are known: S1@2026-03-01"
            )
        try:
            begin = datetime.combine(date.fromisoformat(day), time(), UTC)
        except ValueError:
            raise ValueError(f"section {code} must have a day such as 2026-03-01 behind its @") from None
        dated.append((code, int(begin.timestamp()) * SECOND_NS))
    return dated


PREFIX = "TREADWATCH_"
MOST_WORKERS = 256
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
Given = TypeVar("Given")


def _must(is_right: Callable[[Given], bool], reason: str) -> AfterValidator:
    def checked(value: Given) -> Given:
        if value is not None and not is_right(value):
            raise ValueError(reason)
        return value

    return AfterValidator(checked)


DATABASES = ("sqlite:///", "postgresql://", "postgresql+psycopg://")
DatabaseUrl = Annotated[
    str, _must(lambda url: url.startswith(DATABASES), "must begin with sqlite:/// or postgresql://")
]
SchedulerAddress = Annotated[str, _must(lambda url: "://" in url, "must be an address such as tcp://scheduler:8786")]
PlaceOfKeys = Annotated[
    str,
    _must(
        lambda url: not url.startswith("http://") or urlsplit(url).hostname in LOOPBACK,
        "must be https:// or a file: whoever can change keys on their way can sign tokens",
    ),
]


class Settings(BaseSettings):
    """Everything that differs between deployments; the defaults are the embedded one.

    Args:
        data_dir: Directory of everything that is kept beside the database: raw recordings, samples of windows. The
            embedded database is here too.
        raw_store: Where raw recordings are kept: ``file:///absolute/path`` or ``s3://bucket/prefix``; left out, ``raw``
            in ``data_dir``.
        s3_endpoint, s3_region: Of the S3-compatible store; left out, those of AWS.
        s3_allow_http: Whether an endpoint beyond this machine may be ``http://``.
        s3_timeout_s: How long one request to the store may take, in seconds.
        database_url: ``sqlite:///...`` or ``postgresql://...``; left out, the server at ``database_host``, or without
            one a SQLite file in ``data_dir``.
        database_host, database_port, database_name, database_user, database_password: A PostgreSQL server in parts; the
            password may contain any character.
        rules_file: TOML file of alert rules; left out, the rules shipped with the package.
        retention_file: TOML file of how long what is kept; left out, the shipped numbers of days.
        host, port: Where the REST API listens.
        access: ``keys``: who asks needs a key or a token. ``open``: nobody does; on loopback alone, unless it says
            ``open to everyone who reaches this address``.
        hosts, origins: Names under which the REST API is reached, and origins of pages that may change something,
            beside its own; with commas between them.
        trusted_proxies: Addresses of proxies whose ``X-Forwarded-For`` is believed, with commas between them.
        https: Whether a proxy serves the REST API by HTTPS alone: browsers then ask for nothing else.
        metrics, docs: Whether ``/metrics``, and ``/docs`` with ``/openapi.json``, need a ``key``, are ``open``, or
            ``off``.
        requests_per_s, requests_burst, failed_keys_per_minute, streams_per_key, max_body_kb: What one key may ask on
            average and at once, how often one address may err, how many streams one key may hold open, and how large a
            body may be.
        oidc_issuer, oidc_audience, oidc_keys: Which tokens of an OpenID Connect provider are taken: issuer, audience,
            URL or file of its public keys.
        oidc_owner_claim, oidc_scopes_claim, oidc_fleets_claim, oidc_leeway_s: Which claims say what, and how far clocks
            may differ, in seconds.
        log_level, log_format: How much is logged, and whether as JSON lines or as text for a terminal.
        window_length_s: Length of a window of running time, in seconds. Windows are cut at multiples of it, so it must
            not be changed after data are stored.
        jobs_every_s: Interval of all scheduled jobs, in seconds; left out, each job has its own.
        workers: How many processes of this machine estimate; ``auto`` is one for each processor, 1 does without
            processes.
        worker_memory_mb: How many megabytes a worker process may have after a unit of work before it is replaced.
        lease_s: How long what a process works on is kept from others once that process is gone or stands still, in
            seconds.
        unit_limit_s: How long a worker process of this machine may take for a unit of work before it is ended, in
            seconds.
        dask_scheduler: URL of a Dask scheduler whose workers estimate in place of processes of this machine.
        catalogues: Mapping files of buses of one's own, with ``:`` between them (``;`` on Windows); left out, all
            vehicles have the shipped bus.
        compiled_dir: Directory of compiled code; left out, the user's own for caches (XDG_CACHE_HOME). Only who may run
            the services may write there.
        compiled_cpu: ``host``: code for the CPU of this machine. ``portable``: code that other machines of its kind
            load too.
        rails_known_sections: Track sections whose rails are as on file, each with the day for which that is known:
            ``S1@2026-03-01``, with commas between; all others are compared with them.
        rails_limit: On what rails add to the conicity of the wheel as designed, over those on file.
        spool_mb, spool_memory_mb: How many megabytes of a live bus may wait for their receipt on the disk, and in
            memory while the disk takes nothing; of each vehicle.
        database_connect_timeout_s, database_silence_s, database_statement_timeout_s: How long a database server may
            take to accept a connection, to say anything before it is asked whether it is there, and for one statement,
            in seconds.
        max_chunk_mb, max_uploads, upload_timeout_s: How large a chunk may be that is sent over HTTP or through a drop
            folder, how many one process receives at the same time, and how long one may take, in seconds.
        backlog_chunks, backlog_mb, free_disk_mb: How many chunks, and megabytes of them, may wait to be decoded, and
            how many megabytes of the disk stay free; beyond, no chunk is taken.
        kafka_servers, kafka_topic, kafka_properties: Brokers of the topic of references to chunks, ``host:port`` with
            commas between them; left out, there is none. Its name. A file of properties of librdkafka, such as those of
            TLS and SASL.
        shutdown_timeout_s: How long running requests and jobs may take to finish after SIGTERM, in seconds.
        max_connections: How many connections the REST API holds at the same time; fewer where the process may open
            fewer files.
        max_streams: How many clients of one process may wait for news of the feed, with a stream or a long poll.
        webhook_networks: Private networks that webhooks may lead to, as CIDRs with commas between them.
        webhook_timeout_s: How long one attempt to hand an event to a webhook may take in all, in seconds.
        header_timeout_s, body_timeout_s, request_timeout_s: How long the REST API waits for the headers of a request,
            for its body and for its own answer, in seconds.
    """

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_file=".env", env_file_encoding="utf-8", extra="ignore", frozen=True
    )

    data_dir: Path = Path("treadwatch-data")
    raw_store: Annotated[str | None, _must(names_store, "must be file:///absolute/path or s3://bucket/prefix")] = None
    s3_endpoint: Annotated[str | None, _must(names_endpoint, "must be https://host or https://host:port")] = None
    s3_region: str | None = None
    s3_allow_http: bool = False
    s3_timeout_s: float = Field(default=30.0, ge=0.1, le=600.0)
    database_url: DatabaseUrl | None = Field(default=None, repr=False)  # it may carry a password
    database_host: str | None = None
    database_port: int = Field(default=5432, ge=1, le=65535)
    database_name: str = "treadwatch"
    database_user: str = "treadwatch"
    database_password: str | None = Field(default=None, repr=False)
    rules_file: Path | None = None
    retention_file: Path | None = None
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    access: Literal["keys", "open", "open to everyone who reaches this address"] = "keys"
    hosts: str | None = None
    origins: str | None = None
    trusted_proxies: str | None = None
    https: bool = False
    metrics: Literal["key", "open", "off"] = "key"
    docs: Literal["key", "open", "off"] = "key"
    requests_per_s: float = Field(default=50.0, gt=0.0, le=1e6)
    requests_burst: int = Field(default=500, ge=1, le=1_000_000)
    failed_keys_per_minute: float = Field(default=10.0, gt=0.0, le=6e4)
    streams_per_key: int = Field(default=10, ge=1, le=10_000)
    max_body_kb: int = Field(default=1024, ge=1, le=1 << 20)
    oidc_issuer: str | None = None
    oidc_audience: str | None = None
    oidc_keys: PlaceOfKeys | None = None
    oidc_owner_claim: str = "sub"
    oidc_scopes_claim: str = "scope"
    oidc_fleets_claim: str = "fleets"
    oidc_leeway_s: float = Field(default=30.0, ge=0.0, le=600.0)
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["json", "text"] = "text"
    window_length_s: float = Field(default=60.0, gt=0.0, le=3600.0)
    jobs_every_s: float | None = Field(default=None, gt=0.0)
    compiled_dir: Path | None = None
    compiled_cpu: Literal["host", "portable"] = "host"
    rails_known_sections: Annotated[str | None, _must(lambda sections: known_sections(sections) is not None, "")] = None
    rails_limit: float = Field(default=RailsParameters().limit, gt=0.0, lt=1.0)
    workers: Annotated[
        int | Literal["auto"],
        _must(lambda n: isinstance(n, str) or 1 <= n <= MOST_WORKERS, f"must be auto, or from 1 to {MOST_WORKERS}"),
    ] = 1
    worker_memory_mb: int = Field(default=1024, ge=256, le=1 << 20)
    lease_s: float = Field(default=60.0, ge=1.0, le=3600.0)
    unit_limit_s: float = Field(default=3600.0, ge=1.0, le=86400.0)
    dask_scheduler: SchedulerAddress | None = None
    catalogues: str | None = None
    spool_mb: int = Field(default=1024, ge=1)
    spool_memory_mb: int = Field(default=64, ge=1)
    database_connect_timeout_s: int = Field(default=5, ge=2, le=60)
    database_silence_s: float = Field(default=10.0, ge=1.0, le=600.0)
    database_statement_timeout_s: float = Field(default=600.0, ge=1.0, le=86_400.0)
    max_chunk_mb: int = Field(default=64, ge=1, le=100_000)
    max_uploads: int = Field(default=64, ge=1, le=10_000)
    upload_timeout_s: float = Field(default=600.0, gt=0.0, le=86_400.0)
    backlog_chunks: int = Field(default=10_000, ge=1)
    backlog_mb: int = Field(default=20_000, ge=1)
    free_disk_mb: int = Field(default=1_000, ge=0)
    kafka_servers: str | None = None
    kafka_topic: str = Field(default="treadwatch.chunks", pattern=r"^[A-Za-z0-9._-]{1,249}$")
    kafka_properties: Path | None = None
    shutdown_timeout_s: int = Field(default=10, ge=1, le=600)
    max_connections: int = Field(default=1000, ge=1, le=100_000)
    max_streams: int = Field(default=500, ge=1, le=100_000)
    webhook_networks: str | None = None
    webhook_timeout_s: float = Field(default=15.0, gt=0.0, le=30.0)
    header_timeout_s: float = Field(default=10.0, gt=0.0, le=600.0)
    body_timeout_s: float = Field(default=30.0, gt=0.0, le=600.0)
    request_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)

    @model_validator(mode="before")
    @classmethod
    def _empty_is_left_out(cls, values: dict[str, object]) -> dict[str, object]:
        """Read ``TREADWATCH_RULES_FILE=`` (as compose files leave it) as not set."""
        return {name: value for name, value in values.items() if value != ""}

    @property
    def url(self) -> str:
        """The database's address, with the embedded default filled in."""
        if self.database_url is not None:
            return self.database_url
        if self.database_host is not None:
            password = "" if self.database_password is None else f":{quote(self.database_password, safe='')}"
            where = f"[{self.database_host}]" if ":" in self.database_host else self.database_host
            who = f"{quote(self.database_user, safe='')}{password}"
            return f"postgresql://{who}@{where}:{self.database_port}/{quote(self.database_name, safe='')}"
        return f"sqlite:///{(self.data_dir / 'treadwatch.sqlite').resolve()}"

    @property
    def window_length_ns(self) -> int:
        """Length of a window, ns."""
        return round(self.window_length_s * SECOND_NS)

    @property
    def worker_count(self) -> int:
        """How many worker processes there are."""
        return len(os.sched_getaffinity(0)) if isinstance(self.workers, str) else self.workers

    @property
    def on_server(self) -> bool:
        """Whether the database is on a server, which may be away for a while."""
        return not self.url.startswith("sqlite")

    @property
    def catalogue_files(self) -> tuple[Path, ...]:
        """Mapping files of buses of one's own."""
        return tuple(Path(name) for name in (self.catalogues or "").split(os.pathsep) if name)

    @property
    def receiving_dir(self) -> Path:
        """Where recordings are while they are sent to a bucket, and copies of it while they are read."""
        return self.data_dir / "receiving"

    @property
    def spool_dir(self) -> Path:
        """Where what was received from live buses waits for its receipt."""
        return self.data_dir / "spool"


def load_settings(**overrides: object) -> Settings:
    """Read the environment; ``overrides`` that are not None win. An error names the variable, not its secret value."""
    given = {name: value for name, value in overrides.items() if value is not None}
    try:
        return Settings(**given)  # type: ignore[arg-type]
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        name = "_".join(str(part) for part in first["loc"])
        raise ParameterError(first["msg"], field=f"{PREFIX}{name.upper()}") from None


FOR_EVER = "for ever"
Days = Annotated[float, Field(gt=0.0, le=36_500.0)] | Literal["for ever"] | None
_DAYS: dict[str, Any] = {kind.value: (Days, None) for kind in Kept}
DaysTable = create_model("DaysTable", __base__=InputTable, **_DAYS)


class RetentionTable(InputTable):
    """The whole file."""

    days: DaysTable  # type: ignore[valid-type]  # made above


def load_retention(path: Path) -> Retention:
    """Return the retention of a TOML file; an InputError names the file, the line and the field."""
    file = read_toml(path)
    given = file.parse(RetentionTable).days
    chosen = {kind.value: getattr(given, kind.value) for kind in Kept}
    changed = {name: None if days == FOR_EVER else days for name, days in chosen.items() if days is not None}
    try:
        return Retention(**changed)
    except ParameterError as error:
        raise file.error(error.reason, ("days", str(error.field))) from error
