"""Clients of the topic: their configuration, from the settings and a properties file of librdkafka."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, TypeVar

from estimation.errors import InputError, PassingFaultError
from estimation.values.reasons import ReasonCode
from ingest.input_file import SETTINGS_BYTES, read_text_within

GROUP = "treadwatch"  # the one group of all consumers of a deployment
OURS = frozenset(
    {
        "bootstrap.servers",
        "metadata.broker.list",
        "client.id",
        "group.id",
        "group.instance.id",
        "group.protocol",
        "group.remote.assignor",
        "partition.assignment.strategy",
        "enable.idempotence",
        "acks",
        "request.required.acks",
        "transactional.id",
        "enable.auto.commit",
        "auto.commit.enable",
        "enable.auto.offset.store",
        "auto.offset.reset",
    }
)
"""Properties on which it rests that nothing is lost: a file cannot set them."""

_LOGGED = MappingProxyType({"log_level": 2})  # faults are reported once, not at each of its attempts
_PRODUCER: Mapping[str, Any] = MappingProxyType(
    {"enable.idempotence": True, "linger.ms": 20, "message.timeout.ms": 300_000}
)
_CONSUMER: Mapping[str, Any] = MappingProxyType(
    {
        "group.id": GROUP,
        "enable.auto.commit": True,  # of what is stored as done, each second and when a partition is given up
        "auto.commit.interval.ms": 1000,
        "enable.auto.offset.store": False,
        "auto.offset.reset": "earliest",
        "partition.assignment.strategy": "cooperative-sticky",
        "session.timeout.ms": 10_000,
        "heartbeat.interval.ms": 3_000,
        "queued.min.messages": 1000,
        "queued.max.messages.kbytes": 1024,
        "fetch.message.max.bytes": 262_144,
    }
)
Client = TypeVar("Client")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and how its brokers are reached.

    Attributes:
        properties: Of librdkafka beside ours, such as those of TLS and SASL. They may hold passwords.
    """

    servers: str  # brokers, ``host:port`` with commas between them
    name: str
    properties: Mapping[str, str] = field(default_factory=dict, repr=False)

    def producer(self) -> dict[str, Any]:
        """Return the configuration of a producer."""
        return self._common(_PRODUCER)

    def consumer(self) -> dict[str, Any]:
        """Return the configuration of a member of the group."""
        return self._common(_CONSUMER)

    def _common(self, own: Mapping[str, Any]) -> dict[str, Any]:
        fixed = {"bootstrap.servers": self.servers, "client.id": "treadwatch"}
        return {**_LOGGED, **own, **self.properties, **fixed}


def load_properties(path: Path) -> dict[str, str]:
    """Return the properties of a file: lines ``name=value``; empty ones and those that begin with ``#`` are left out.

    Raises:
        InputError: It cannot be read, a line is none of these, or a property is one of ours; never with a value.
    """
    found: dict[str, str] = {}
    for number, line in enumerate(read_text_within(path, SETTINGS_BYTES, InputError).splitlines(), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        name, separator, value = text.partition("=")
        name = name.strip()
        if not separator or not re.fullmatch(r"[a-z0-9._]+", name):
            raise InputError("is no line name=value of a librdkafka property", file=path, line=number)
        if name in OURS:
            raise InputError(f"{name} is set by treadwatch", file=path, line=number)
        found[name] = value.strip()
    return found


def require_client() -> None:
    """Refuse to go on without the library."""
    if importlib.util.find_spec("confluent_kafka") is None:
        missing = "the Kafka client is not installed: pip install 'treadwatch[kafka]'"
        raise PassingFaultError(missing, code=ReasonCode.WAITS_FOR_EXTRA)


def kafka() -> ModuleType:
    """Return the library, which is an extra and imported where it is used."""
    return importlib.import_module("confluent_kafka")


def connected(make: Callable[[], Client], topic: Topic) -> Client:
    """Return a client, or refuse a configuration that cannot be used; the brokers need not be there.

    Raises:
        InputError: A property cannot be used. Its value is not repeated: it may be a secret.
    """
    try:
        return make()
    except kafka().KafkaException as error:
        text = str(error)
        named = next((name for name in sorted(topic.properties, key=len, reverse=True) if name in text), None)
        which = "a property" if named is None else f"the property {named}"
        raise InputError(f"{which} of the Kafka client cannot be used") from None
