"""An S3 server for the tests: SeaweedFS, from the wheel that carries its program, on loopback alone."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from obstore.exceptions import BaseError
from obstore.store import S3Store

ACCESS_KEY, SECRET_KEY = "TESTERKEY", "only-for/these+tests"
BUCKET = "fleet"
START_TIMEOUT_S = 60.0
LISTENING = ("master.port", "volume.port", "filer.port", "s3.port", "admin.port")
SERVICES = ("master", "volume", "filer", "s3", "admin")


@dataclass
class S3Server:
    """A server that can be taken away and brought back, with its objects as they were."""

    home: Path
    ports: Mapping[str, int]
    process: subprocess.Popen[bytes] | None = field(default=None)

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.ports['s3.port']}"

    def environment(self, prefix: str = "") -> dict[str, str]:
        """Return the settings of a deployment whose raw recordings are here, by their variables."""
        return {
            "TREADWATCH_RAW_STORE": f"s3://{BUCKET}/{prefix}".rstrip("/"),
            "TREADWATCH_S3_ENDPOINT": self.endpoint,
            "AWS_ACCESS_KEY_ID": ACCESS_KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET_KEY,
        }

    def objects(self, prefix: str = "") -> S3Store:
        """Return what reads and writes objects behind the back of a deployment."""
        return S3Store(
            BUCKET,
            prefix=prefix or None,
            endpoint=self.endpoint,
            access_key_id=ACCESS_KEY,
            secret_access_key=SECRET_KEY,
            client_options={"allow_http": True},
            retry_config={"max_retries": 0},
        )

    def start(self) -> None:
        """Start it and wait until it takes objects."""
        program = Path(sysconfig.get_path("scripts")) / "weed"
        options = [f"-{name}={port}" for name, port in self.ports.items()]
        quiet = ["-master.telemetry=false", "-admin.ui=false", "-webdav=false", "-s3.port.iceberg=0"]
        quiet += ["-s3.port.lance=0", "-s3.autoCreateBucket=false", "-volume.max=8", f"-bucket={BUCKET}"]
        command = [str(program), "mini", f"-dir={self.home}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", *options, *quiet]
        keys = {"AWS_ACCESS_KEY_ID": ACCESS_KEY, "AWS_SECRET_ACCESS_KEY": SECRET_KEY}
        known = {"PATH": os.environ["PATH"], "HOME": str(self.home)}
        with (self.home / "log").open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=known | keys, cwd=self.home)
        self._wait()

    def stop(self) -> None:
        """Stop it at once, as in a crash."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(120)
            self.process = None
        for service in SERVICES:
            for port in self.ports.values():
                for name in (f"seaweedfs-{service}-{port}.sock", f"seaweedfs-{service}-grpc-{port}.sock"):
                    (Path("/tmp") / name).unlink(missing_ok=True)  # noqa: S108 - where the server puts them

    def _wait(self) -> None:
        until, log = time.monotonic() + START_TIMEOUT_S, self.home / "log"
        objects = self.objects("of-the-server")
        while True:
            assert self.process is not None
            assert self.process.poll() is None, log.read_text()
            assert time.monotonic() < until, log.read_text()
            try:
                objects.put("ready", b"ready")
            except (BaseError, FileNotFoundError):
                time.sleep(0.05)
            else:
                return


@contextmanager
def running_s3_server() -> Iterator[S3Server]:
    """Yield a running server that only this process knows; it ends with the block."""
    home = Path(tempfile.mkdtemp(prefix="treadwatch-s3-"))
    names = [name for port in LISTENING for name in (port, f"{port}.grpc")]
    server = S3Server(home, dict(zip(names, _free_ports(len(names)), strict=True)))
    try:
        server.start()
        yield server
    finally:
        server.stop()
        shutil.rmtree(home)


def _free_ports(count: int) -> list[int]:
    """Return ports that nobody listens on, each another one."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports
