"""Whether the service is alive, ready, and what it measures; without a version in the path, as probes expect it."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import Field
from starlette.responses import PlainTextResponse

from api.problems import described
from api.schemas.common import Representation
from api.services import ServicesDep

router = APIRouter(tags=["health"])


class Health(Representation):
    """The service answers."""

    status: Literal["ok"] = Field(description="The service answers.")


@router.get("/healthz", response_model=Health)
async def get_health() -> Health:
    """Report that the process is alive; checks nothing else."""
    return Health(status="ok")


@router.get("/readyz", response_model=Health, responses=described(503))
def get_readiness(services: ServicesDep) -> Health:
    """Report whether the database answers and is at the right migration."""
    services.check()
    return Health(status="ok")


@router.get("/metrics", response_class=PlainTextResponse, responses=described(401, 403, 429))
def get_metrics(request: Request) -> Response:
    """Return the measures in Prometheus' text format."""
    return Response(generate_latest(request.app.state.registry), media_type=CONTENT_TYPE_LATEST)
