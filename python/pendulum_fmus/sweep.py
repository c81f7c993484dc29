"""Run a sweep on many processes or machines with Dask.

The rows are the same as from `cargo fmu sweep`, byte for byte. With one process per core:

    python -m pendulum_fmus.sweep examples/sweep/gains.toml --out target/gains.csv

On several machines of the same platform, start a scheduler on one and workers on each:

    dask scheduler --host HOST
    dask worker tcp://HOST:8786 --nworkers auto --nthreads 1

Then add `--scheduler tcp://HOST:8786` to the command. The workers need the same version of
`dask.distributed`, but nothing of this project: each receives the native program, the sweep, the
system and the FMUs in a folder that is removed when the worker ends.

A killed sweep resumes when the same command is run again. `cargo fmu sweep` can resume it too, as
it uses the same journal: the name of the table with the suffix `.part`.

Dask executes any code that it receives: whoever can reach the scheduler can run any program on its
workers, and a worker can send anything to the coordinator. Use a trusted network or Dask's TLS.
"""

import argparse
import contextlib
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from dask.distributed import (
    Client,
    Future,
    KilledWorker,
    LocalCluster,
    WorkerPlugin,
    as_completed,
    get_worker,
)
from distributed.client import FutureCancelledError
from distributed.comm import CommClosedError
from tqdm import tqdm

from pendulum_fmus.project import PROGRAM

RETRIES = 3
"""Number of retries of a chunk whose program was killed on its worker."""

INTERRUPTED = (130, 143)
"""Exit codes of the program after Ctrl-C and SIGTERM."""

MOST = 1000
"""Maximum number of runs per chunk by default, which a killed worker may have to repeat."""

PRELOAD = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
"""
"""Local workers ignore Ctrl-C and print nothing; the coordinator stops them and reports errors."""


class SweepError(Exception):
    """An error that ends the sweep, with a message for the user."""


# --- workers ------------------------------------------------------------------------------------


class Files(WorkerPlugin):
    """The files of a sweep, by name, in a folder of every worker, also of those that join later."""

    def __init__(self, files: dict[str, Path]):
        self.name = f"sweep-{uuid.uuid4().hex}"
        self.files = {name: path.read_bytes() for name, path in files.items()}

    def setup(self, worker) -> None:
        """Write the files."""
        self.folder = Path(worker.local_directory) / self.name
        (self.folder / "fmus").mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (self.folder / name).write_bytes(content)
        (self.folder / "cargo-fmu").chmod(0o700)

    def teardown(self, worker) -> None:
        """Remove the files."""
        shutil.rmtree(self.folder, ignore_errors=True)


def simulate(plugin: str, first: int, end: int) -> subprocess.CompletedProcess:
    """Run the program for some runs on the current worker."""
    folder = get_worker().plugins[plugin].folder
    options = ["--system", "system.toml", "--fmus", "fmus", "--threads", "1"]
    command = [folder / "cargo-fmu", "sweep", "sweep.toml", *options, f"--rows={first}..{end}"]
    # FMUs are unpacked in the folder, too, so that they are removed with the worker
    place = {"cwd": folder, "env": {**os.environ, "TMPDIR": str(folder)}}
    result = subprocess.run(command, capture_output=True, check=False, **place)
    if result.returncode < 0 or result.returncode in INTERRUPTED:
        raise ChildProcessError(f"the program was killed ({result.returncode})")
    return result


@contextlib.contextmanager
def connected(options: argparse.Namespace) -> Iterator[Client]:
    """Connect to a scheduler, or start one with workers on this machine."""
    with contextlib.ExitStack() as stack:
        address = options.scheduler
        if address is None:
            cluster = LocalCluster(
                n_workers=options.workers, threads_per_worker=1, host="127.0.0.1",
                dashboard_address=None, preload=PRELOAD, silence_logs=logging.CRITICAL,
            )  # fmt: skip
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = Client(address, timeout=5)
        except OSError as error:
            raise SweepError(
                f"no scheduler is running at {address}; `dask scheduler` starts one"
            ) from error
        yield stack.enter_context(client)


# --- the coordinator ----------------------------------------------------------------------------


def checked(result: subprocess.CompletedProcess) -> bytes:
    """Return the output of the native program, which must not have failed."""
    if result.returncode in INTERRUPTED:
        raise KeyboardInterrupt
    if result.returncode:
        said = result.stderr.decode().removeprefix("error: ").strip()
        raise SweepError(said or f"the program exited with code {result.returncode}")
    return result.stdout


def rows_of(future: Future, first: int, end: int) -> bytes:
    """Return the rows of a chunk."""
    name = f"the runs {first}..{end}"
    try:
        rows = checked(future.result())
    except KilledWorker as error:
        raise SweepError(f"{name} crash every worker that runs them") from error
    except CommClosedError:
        raise
    except OSError as error:
        raise SweepError(
            f"a worker failed at {name}: {error}; does it run on the same platform?"
        ) from error
    if sorted(int(row.split(b",", 1)[0]) for row in rows.splitlines()) != [*range(first, end)]:
        raise SweepError(f"a worker returned rows that do not match {name}")
    return rows


def compute(client: Client, files: Files, missing: list, rows: IO, size: int | None) -> None:
    """Simulate the missing runs, and write their rows."""
    threads, begin = sum(client.nthreads().values()), time.monotonic()
    if not threads:
        print(f"no worker yet; `dask worker {client.scheduler.address}` starts one", flush=True)
    left = sum(end - first for first, end in missing)
    size = size or max(1, min(left // (8 * max(1, threads)), MOST))
    chunks = [(k, min(k + size, end)) for first, end in missing for k in range(first, end, size)]
    client.register_plugin(files, name=files.name)
    try:
        submitted = {client.submit(simulate, files.name, *c, retries=RETRIES): c for c in chunks}
        with tqdm(total=left, unit="run", leave=False, disable=None) as bar:
            for future in as_completed(submitted):
                first, end = submitted[future]
                rows.write(rows_of(future, first, end))
                rows.flush()
                bar.update(end - first)
    finally:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            client.unregister_worker_plugin(files.name)
    seconds = time.monotonic() - begin
    print(f"{left} runs in {seconds:.3f} s: {left / seconds:.0f} a second")


def files_of(program: Path, sweep: Path, plan: dict) -> Files:
    """Return the files of a sweep by their names on the workers."""
    files = {"cargo-fmu": program, "sweep.toml": sweep, "system.toml": Path(plan["system"])}
    for fmu in map(Path, plan["fmus"]):
        other = files.setdefault(f"fmus/{fmu.name}", fmu)
        if other.read_bytes() != fmu.read_bytes():
            raise SweepError(f"{other} and {fmu} are different FMUs; give them different names")
    return Files(files)


def sweep(options: argparse.Namespace) -> None:
    """Run the sweep of the command line; the native program keeps the journal."""
    program = options.program.resolve()
    if not program.is_file():
        raise SweepError(f"cannot run {program}: `make fmus` builds the program")
    command = [program, "sweep", options.sweep, "--collect"]
    command += ["--out", options.out] if options.out else []
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with (
        tempfile.TemporaryFile() as errors,  # a pipe that nobody reads would become full
        subprocess.Popen(list(map(str, command)), **pipes, stderr=errors) as collector,
    ):
        if outline := collector.stdout.readline():
            plan, missing = json.loads(outline)
            files = files_of(program, options.sweep, plan)
            with connected(options) as client, contextlib.suppress(BrokenPipeError):
                compute(client, files, missing, collector.stdin, options.chunk)
            done = plan["runs"] - sum(end - first for first, end in missing)
            print(f"{done} runs were already done\n" if done else "", end="")
        said, _ = collector.communicate()
        errors.seek(0)
        result = subprocess.CompletedProcess(command, collector.returncode, said, errors.read())
    print(checked(result).decode(), end="")


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return int(text)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m pendulum_fmus.sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    # fmt: off
    add("sweep", type=Path, metavar="SWEEP.toml", help="sweep file")
    add("--out", type=Path, metavar="FILE",
        help="output file, .csv or .parquet (default: the name of the sweep file with .csv)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="tcp://HOST:PORT",
        help="scheduler whose workers execute the runs (default: workers on this machine)")
    where.add_argument("--workers", type=positive, metavar="N",
        help="worker processes on this machine (default: one per core)")
    add("--chunk", type=positive, metavar="RUNS",
        help="runs per task, which are repeated if the worker is killed (default: an eighth of a"
        f" worker's share, at most {MOST})")
    add("--program", type=Path, default=PROGRAM, metavar="FILE",
        help="the native program (default: target/debug/cargo-fmu of this project)")
    # fmt: on
    return parser.parse_args()


def main() -> int:
    """Run the script; return its exit status."""
    options = arguments()
    logging.disable()  # Dask recovers from lost workers; a lost scheduler is reported here
    try:
        sweep(options)
    except SweepError as error:
        print(f"sweep.py: {error}", file=sys.stderr)
        return 1
    except (FutureCancelledError, CommClosedError):
        print("sweep.py: lost the scheduler; run the same command to resume", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("sweep.py: interrupted; run the same command to resume", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
