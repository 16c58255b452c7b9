"""A Dask cluster on this host for tests: processes that can be killed."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest


class Cluster:
    """A Dask scheduler and workers on this host, each a process."""

    def __init__(self, folder: Path) -> None:
        pytest.importorskip("distributed")
        file = folder / "scheduler.json"
        # Workers find the tests' modules as an installed package would be found.
        paths = os.pathsep.join([str(Path(__file__).parent), *(path for path in sys.path if path)])
        self._folder, self._environment = folder, os.environ | {"PYTHONPATH": paths}
        self._options = ["--scheduler-file", str(file)]
        self._processes: list[subprocess.Popen[bytes]] = []
        self._start("scheduler", "--port", "0", "--host", "127.0.0.1", "--no-dashboard")
        end = time.monotonic() + 60.0
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.1)
        self.address = json.loads(file.read_text())["address"]

    def worker(self) -> subprocess.Popen[bytes]:
        """One more, of one thread, that nobody starts again."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self._folder)]
        return self._start("worker", *options)

    def _start(self, kind: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + kind, *self._options, *options]
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(command, env=self._environment, stdout=quiet, stderr=quiet)
        self._processes.append(process)
        return process

    def close(self) -> None:
        for process in reversed(self._processes):
            process.kill()
            process.wait()
