"""The simulator stands on the far side of the bus: what it shares with the product is listed here, and nothing else."""

from __future__ import annotations

import grimp

ALLOWED = (
    "estimation.compiled",
    "estimation.contact",
    "estimation.errors",
    "estimation.values",
    "estimation.vehicle",
    "ingest.live.listening",
    "ingest.catalogue",
    "ingest.codec",
    "ingest.file_value",
    "ingest.frames",
    "ingest.input_file",
    "ingest.logs.blf_layout",
    "ingest.profiles",
    "ingest.simulator",
    "ingest.track_file",
    "ingest.vehicle_class_schema",
)


def allowed(module: str) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in ALLOWED)


def test_the_simulator_imports_only_what_is_listed() -> None:
    graph = grimp.build_graph("api", "ingest", "fleet_db", "estimation")
    simulator = {"ingest.simulator"} | graph.find_descendants("ingest.simulator")
    assert len(simulator) > 10
    imports = {
        (module, imported) for module in simulator for imported in graph.find_modules_directly_imported_by(module)
    }
    assert sorted(pair for pair in imports if not allowed(pair[1])) == []
