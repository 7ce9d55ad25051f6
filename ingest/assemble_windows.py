"""Job: windows of stale spans are assembled again, recordings decoded whose vehicle has come or that are due again.

It reads raw recordings, so it is defined here and joins the other jobs where all is joined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from estimation.jobs.job import Job, JobContext
from estimation.jobs.runner import run as run_stage
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.held import ASSEMBLY, HeldRecordings, missing
from ingest.intake.backlog import decode_received
from ingest.receiver import ChunkReceipt, Receiver


def assemble_windows(
    storage_of: Callable[[JobContext], SqlStorage], receiver_of: Callable[[JobContext], Receiver]
) -> Job:
    """Return the job.

    Args:
        storage_of, receiver_of: Storage and receiver of a deployment; the receiver is asked for only where there is
            something to do.
    """

    def run(context: JobContext) -> Mapping[str, int]:
        counts = dict.fromkeys(("spans", "decoded", "new", "changed", "removed", "healed", "quarantined"), 0)
        with storage_of(context).read() as unit:
            counts["spans"] = len(unit.stale_spans.all())
            waiting = list(unit.chunks.of_known_vehicles())
            looked_for = missing(unit)
            received = unit.chunks.undecoded_size().count
            waiting += HeldRecordings(storage_of(context), context.clock).due(unit)
        if not counts["spans"] and not waiting and not looked_for and not received:
            return counts
        receiver = receiver_of(context)
        receipts = [one.record for one in receiver.decode(waiting) if isinstance(one, ChunkReceipt)]
        counts["decoded"] = sum(record.state is ChunkState.DECODED for record in receipts)
        counts["decoded"] += decode_received(storage_of(context), receiver, ASSEMBLY, context.checkpoint).decoded
        receiver.reassembler.lost.look()
        made = run_stage(receiver.reassembler.stage, replace(context, executor=None))  # workers have no recordings
        return counts | {name: count for name, count in made.items() if name not in {"vehicles", "results"}}

    return Job(
        ASSEMBLY, "Assemble windows again whose recordings, registry or files have changed", every_s=60.0, run=run
    )
