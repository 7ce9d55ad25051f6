"""The topic of references as a deployment sets it, and what publishes to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import TypeVar

from api.settings import PREFIX, Settings
from estimation.errors import InputError, ParameterError
from fleet_db.storage import SqlStorage
from ingest.receipts import Announce, to_nobody
from ingest.topic.client import Topic, load_properties
from ingest.topic.publishing import Publisher

Client = TypeVar("Client")


def topic_of(settings: Settings) -> Topic | None:
    """Return the topic; None where no brokers are set. An error in its properties names the line, never a value."""
    if settings.kafka_servers is None:
        return None
    properties = {} if settings.kafka_properties is None else load_properties(settings.kafka_properties)
    return Topic(settings.kafka_servers, settings.kafka_topic, properties)


def publisher(settings: Settings, storage_of: Callable[[], SqlStorage | None]) -> Publisher | None:
    """Return what publishes references to received chunks; None where no brokers are set."""

    def fleet_of(vehicle: str) -> str:
        storage = storage_of()
        if storage is None:
            return ""
        with storage.read() as unit:
            return unit.registry.vehicle(vehicle).fleet

    topic = topic_of(settings)
    return None if topic is None else with_named_setting(lambda: Publisher(topic, fleet_of))


@contextmanager
def publishing(settings: Settings, storage_of: Callable[[], SqlStorage | None]) -> Iterator[Announce]:
    """Yield what announces receipts on the topic, to nobody where none is set; what waits at the end is published."""
    references = publisher(settings, storage_of)
    if references is None:
        yield to_nobody
        return
    with closing(references):
        yield references.publish


def with_named_setting(make: Callable[[], Client]) -> Client:
    """Return a client; a refusal of its configuration names the setting."""
    try:
        return make()
    except InputError as error:
        raise ParameterError(error.reason, field=f"{PREFIX}KAFKA_PROPERTIES") from None
