"""Print as JSON which functions of the product run between one recording and the REST answers of a wheelset.

``python -P bench/frame_trace.py WHEELSET RECORDING`` in the environment of a deployment that knows the wheelset
(``-P``: the packages of ``PYTHONPATH`` go before this folder). In this one process it receives the recording
(``ingest``), runs the jobs one by one (``estimate --job``) and asks the ASGI application for the wheelset's geometry,
trend and alerts. The output maps each stage to the files of the four packages, and each file to the functions that were
called. What runs while a module is imported is not counted; neither are class bodies, nor methods that the
interpreter generates, which have no file. Compiled kernels are not seen; the functions that call them are. The thread
that waits for webhooks is left out: it runs beside, at no certain time.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import threading
from importlib import import_module
from inspect import CO_NEWLOCALS
from pathlib import Path
from types import CodeType, FrameType

PACKAGES = ("api", "ingest", "fleet_db", "estimation")
JOBS = ("estimate_windows", "refresh_geometry", "refresh_trends", "evaluate_alerts")
ALIGNMENT_JOB = "refresh_alignment"
BESIDE = "webhooks"
"""Name of the thread of the REST API that has no part in an answer."""


class Trace:
    """The code objects that were entered, by stage."""

    def __init__(self) -> None:
        self.roots = tuple(str(Path(str(import_module(name).__file__)).parent) for name in PACKAGES)
        self.entered: dict[str, set[CodeType]] = {}
        self._now: set[CodeType] = set()

    def stage(self, name: str) -> None:
        """Count what follows under this name."""
        self._now = self.entered.setdefault(name, set())

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        """Note the function that is entered; the profiler's hook."""
        if event != "call" or frame.f_code in self._now:
            return
        if threading.current_thread().name != BESIDE and self._ours(frame.f_code) and not self._importing(frame):
            self._now.add(frame.f_code)

    def _ours(self, code: CodeType) -> bool:
        return code.co_filename.startswith(self.roots)

    def _importing(self, frame: FrameType) -> bool:
        above: FrameType | None = frame
        while above is not None:
            code = above.f_code
            if not code.co_flags & CO_NEWLOCALS and self._ours(code):
                return True
            above = above.f_back
        return False

    def result(self) -> dict[str, dict[str, list[str]]]:
        """Return by stage and file, relative to the packages' folder, the functions entered."""
        entered: dict[str, dict[str, set[str]]] = {}
        for stage, codes in self.entered.items():
            for code in codes:
                root = next(root for root in self.roots if code.co_filename.startswith(root))
                file = str(Path(code.co_filename).relative_to(Path(root).parent))
                entered.setdefault(stage, {}).setdefault(file, set()).add(code.co_qualname)
        return {stage: {file: sorted(names) for file, names in files.items()} for stage, files in entered.items()}


def main() -> None:
    """Run the whole path under the profiler and print what was entered."""
    wheelset, recording = sys.argv[1:]
    trace = Trace()
    threading.setprofile(trace)
    sys.setprofile(trace)
    with contextlib.redirect_stdout(sys.stderr):
        trace.stage("ingest")
        _command_line("ingest", recording)
        trace.stage(ALIGNMENT_JOB)
        _command_line("estimate", "--job", ALIGNMENT_JOB)
        for job in JOBS:
            trace.stage(job)
            _command_line("estimate", "--job", job)
        trace.stage("start of the REST API")
        asyncio.run(_answers(trace, wheelset))
    sys.setprofile(None)
    print(json.dumps(trace.result(), indent=1, sort_keys=True))


def _command_line(*arguments: str) -> None:
    sys.argv = ["treadwatch", *arguments]
    try:
        import_module("api.cli").main()
    except SystemExit as end:
        if end.code:
            raise


async def _answers(trace: Trace, wheelset: str) -> None:
    import httpx  # noqa: PLC0415 - what is imported here is no part of the product's path

    settings = import_module("api.settings").load_settings()
    app = import_module("api.serving").create_app(settings)
    at = f"/v1/wheelsets/{wheelset}"
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://treadwatch") as client,
    ):
        for path in (f"{at}/geometry", f"{at}/trend", f"/v1/alerts?wheelset={wheelset}"):
            trace.stage(path.replace(wheelset, "{serial}"))
            (await client.get(path)).raise_for_status()


if __name__ == "__main__":
    main()
