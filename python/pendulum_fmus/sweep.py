"""Run a sweep on many processes or machines with Dask.

The rows are those of `cargo fmu sweep`, byte for byte. With one process per core:

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
import fcntl
import hashlib
import json
import logging
import os
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from dask.distributed import (
    Client,
    KilledWorker,
    LocalCluster,
    Worker,
    WorkerPlugin,
    as_completed,
    get_worker,
)
from distributed.client import FutureCancelledError
from tqdm import tqdm

from pendulum_fmus.project import PROGRAM

TIMEOUT = 5
"""Time limit for connecting to a scheduler [s]."""

RETRIES = 3
"""Number of retries of a chunk whose program was killed on its worker."""

PRELOAD = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
"""
"""Local workers ignore Ctrl-C and print nothing; the coordinator stops them and reports errors."""

MAX_QUEUED = 1000
"""Maximum number of chunks queued at the scheduler, which limits its memory."""

INTERRUPTED = (130, 143)
"""Exit codes of the program after Ctrl-C and SIGTERM."""

MAX_CHUNK = 1000
"""Default maximum number of runs per chunk, which a killed worker may have to repeat."""


class SweepError(Exception):
    """An error that ends the sweep, with a message for the user."""


# --- the sweep ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """The plan of a sweep, as the native program reports it.

    Parameters
    ----------
    runs
        Number of runs.
    header
        The first lines of the journal.
    files
        The files that a worker needs, by path in its folder.
    """

    runs: int
    header: bytes
    files: dict[str, bytes]


def call(program: Path, *arguments: object) -> str:
    """Run `cargo fmu sweep` on this machine; return its output."""
    command = [program, "sweep", *map(str, arguments)]
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise SweepError(
            f"cannot run {program}: {error.strerror}; `make fmus` builds the program"
        ) from error
    if result.returncode in INTERRUPTED:
        raise KeyboardInterrupt
    if result.returncode:
        raise SweepError(failure_message(result.stderr, result.returncode))
    return result.stdout


def failure_message(stderr: str, code: int) -> str:
    """Return the error message of the program."""
    return stderr.removeprefix("error: ").strip() or f"the program exited with code {code}"


def read_plan(program: Path, sweep: Path) -> Plan:
    """Get the plan from the program and read the files that it names."""
    plan = json.loads(call(program, sweep, "--plan"))
    files = {"cargo-fmu": program, "sweep.toml": sweep, "system.toml": Path(plan["system"])}
    for fmu in dict.fromkeys(map(Path, plan["fmus"])):
        # Workers have all FMUs in one folder, by file name.
        other = files.setdefault(f"fmus/{fmu.name}", fmu)
        if other.read_bytes() != fmu.read_bytes():
            raise SweepError(f"{other} and {fmu} are different FMUs; give them different names")
    contents = {name: path.read_bytes() for name, path in files.items()}
    return Plan(plan["runs"], plan["header"].encode(), contents)


# --- the journal --------------------------------------------------------------------------------


class Journal:
    """The finished rows, in the format of crates/fmu-sweep/src/journal.rs; locked until closed."""

    def __init__(self, path: Path, header: bytes):
        self.path = path
        try:
            self.file = path.open("a+b", buffering=0)
        except OSError as error:
            raise SweepError(f"cannot open {path}: {error.strerror}") from error
        try:
            fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise SweepError(
                f"{path} is in use by another process: wait for it, or give another --out"
            ) from error
        self.length = self._cut(header)
        if self.length == 0:
            self.append(header)
        self.done = self._read_done(header)

    def _cut(self, header: bytes) -> int:
        """Cut off a line torn by a kill, or everything if the header is torn; return the length."""
        self.file.seek(0)
        content = self.file.read()
        if not (content.startswith(header) or header.startswith(content)):
            raise SweepError(
                f"{self.path} belongs to another sweep: delete it or give another --out"
            )
        whole = content.rfind(b"\n") + 1 if content.startswith(header) else 0
        self.file.truncate(whole)
        return whole

    def _read_done(self, header: bytes) -> set[int]:
        self.file.seek(len(header))
        try:
            return set(map(run_of, lines_of(self.file.read())))
        except ValueError as error:
            raise SweepError(f"{self.path} has a line that is not a row: {error}") from error

    def append(self, lines: bytes) -> None:
        """Append whole lines, all of them or none."""
        try:
            if self.file.write(lines) < len(lines):
                raise OSError(0, "incomplete write")
            os.fsync(self.file.fileno())
        except OSError as error:
            self.file.truncate(self.length)
            raise SweepError(f"cannot write {self.path}: {error.strerror}") from error
        self.length += len(lines)

    def close(self) -> None:
        """Close the file, which releases the lock."""
        self.file.close()


def lines_of(text: bytes) -> list[bytes]:
    """Return the lines without their line feeds."""
    return text.split(b"\n")[:-1]


def run_of(line: bytes) -> int:
    """Return the index of the run that a line belongs to."""
    return int(line.split(b",", 1)[0])


def check_rows(rows: bytes, chunk: range) -> None:
    """Check that the rows are exactly those of a chunk."""
    if not rows.endswith(b"\n") or sorted(map(run_of, lines_of(rows))) != list(chunk):
        raise SweepError(f"a worker returned rows that do not match {named(chunk)}")


def chunks(runs: int, done: set[int], size: int) -> Iterator[range]:
    """Yield the remaining runs in ranges of at most `size`."""
    first = 0
    for end in [*sorted(done), runs]:
        yield from (range(k, min(k + size, end)) for k in range(first, end, size))
        first = end + 1


def named(chunk: range) -> str:
    """Return the name of a chunk in messages."""
    return f"the runs {chunk.start}..{chunk.stop}"


# --- workers ------------------------------------------------------------------------------------


class Bundle(WorkerPlugin):
    """The files of a sweep, unpacked on every worker, including those that join later."""

    idempotent = True  # A killed coordinator of the same sweep may have left it registered.

    def __init__(self, files: dict[str, bytes]):
        self.files = files
        digest = hashlib.sha256(repr(sorted(files.items())).encode())
        self.name = f"sweep-{digest.hexdigest()}"

    def setup(self, worker: Worker) -> None:
        """Unpack the files."""
        self.folder = Path(worker.local_directory) / self.name
        for name, content in self.files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        (self.folder / "cargo-fmu").chmod(0o700)

    def teardown(self, worker: Worker) -> None:
        """Remove the files."""
        shutil.rmtree(self.folder, ignore_errors=True)


def simulate(bundle: str, chunk: range) -> subprocess.CompletedProcess[bytes]:
    """Run the program for a chunk of runs on the current worker."""
    folder = get_worker().plugins[bundle].folder
    command = [
        folder / "cargo-fmu", "sweep", folder / "sweep.toml",
        "--system", folder / "system.toml", "--fmus", folder / "fmus",
        "--rows", f"{chunk.start}..{chunk.stop}", "--threads", "1",
    ]  # fmt: skip
    # The FMUs are unpacked there too, so that they are removed with the worker.
    environment = {**os.environ, "TMPDIR": str(folder)}
    result = subprocess.run(command, env=environment, capture_output=True, check=False)
    if result.returncode < 0:
        raise ChildProcessError(f"the program was killed by signal {-result.returncode}")
    if result.returncode in INTERRUPTED:
        raise ChildProcessError("the program was interrupted")
    return result


@contextlib.contextmanager
def connected(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """Connect to a scheduler, or start one with workers on this machine."""
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
                preload=PRELOAD,
                silence_logs=logging.CRITICAL,
            )
            scheduler = stack.enter_context(cluster).scheduler_address
        try:
            client = Client(scheduler, timeout=TIMEOUT)
        except (OSError, ValueError) as error:
            raise SweepError(
                f"no scheduler is running at {scheduler}; `dask scheduler` starts one"
            ) from error
        yield stack.enter_context(client)


@contextlib.contextmanager
def sent(client: Client, bundle: Bundle) -> Iterator[str]:
    """Install the bundle on all workers and remove it at the end; yield its name."""
    client.register_plugin(bundle, name=bundle.name)
    try:
        yield bundle.name
    finally:
        # The scheduler may be gone.
        with contextlib.suppress(Exception):
            client.unregister_worker_plugin(bundle.name)


def results(client: Client, bundle: str, chunks: Iterable[range]) -> Iterator[tuple[range, bytes]]:
    """Run the chunks on the workers; yield each with its rows, in any order."""
    group = f"rows-{uuid.uuid4().hex}"
    chunks = iter(chunks)

    def submit(chunk: range):
        key = (group, chunk.start, chunk.stop)
        return client.submit(simulate, bundle, chunk, key=key, retries=RETRIES)

    pending = as_completed(map(submit, islice(chunks, MAX_QUEUED)))
    for future in pending:
        chunk = range(*future.key[1:])
        try:
            result = future.result()
        except KilledWorker as error:
            raise SweepError(f"{named(chunk)} crash every worker that runs them") from error
        except OSError as error:
            raise SweepError(
                f"a worker failed at {named(chunk)}: {error}; does it run on the same platform?"
            ) from error
        if result.returncode:
            raise SweepError(failure_message(result.stderr.decode(), result.returncode))
        yield chunk, result.stdout
        pending.update(map(submit, islice(chunks, 1)))


# --- the script ---------------------------------------------------------------------------------


def default_chunk(runs: int, threads: int) -> int:
    """Return a chunk size that keeps all threads busy until the end."""
    return max(1, min(runs // (8 * max(1, threads)), MAX_CHUNK))


def compute(client: Client, plan: Plan, journal: Journal, size: int | None) -> None:
    """Execute the remaining runs and append their rows to the journal."""
    left = plan.runs - len(journal.done)
    threads = sum(client.nthreads().values())
    if left and not threads:
        print(f"no worker yet; `dask worker {client.scheduler.address}` starts one", flush=True)
    ranges = chunks(plan.runs, journal.done, size or default_chunk(left, threads))
    begin = time.monotonic()
    with (
        sent(client, Bundle(plan.files)) as bundle,
        tqdm(
            total=plan.runs, initial=len(journal.done), unit="run", leave=False, disable=None
        ) as bar,
    ):
        for chunk, rows in results(client, bundle, ranges):
            check_rows(rows, chunk)
            journal.append(rows)
            bar.update(len(chunk))
    elapsed = time.monotonic() - begin
    print(f"{left} runs in {elapsed:.3f} s: {left / elapsed:.0f} a second")
    if journal.done:
        print(f"{len(journal.done)} runs were already done")


def sweep(options: argparse.Namespace) -> None:
    """Run the sweep of the command line."""
    program = options.program.resolve()
    out = options.out or Path(options.sweep.with_suffix(".csv").name)
    if out.suffix not in (".csv", ".parquet") or out.is_dir():
        raise SweepError(f"{out}: expected a file named .csv or .parquet")
    plan = read_plan(program, options.sweep)
    with connected(options.scheduler, options.workers) as client:
        journal = Journal(out.with_name(f"{out.name}.part"), plan.header)
        with contextlib.closing(journal):
            compute(client, plan, journal, options.chunk)
    print(call(program, options.sweep, "--out", out).splitlines()[-1])


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m pendulum_fmus.sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("sweep", type=Path, metavar="SWEEP.toml", help="sweep file")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="output file, .csv or .parquet (default: the name of the sweep file with .csv)",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="scheduler whose workers execute the runs (default: workers on this machine)",
    )
    where.add_argument(
        "--workers",
        type=positive,
        metavar="N",
        help="worker processes on this machine (default: one per core)",
    )
    add(
        "--chunk",
        type=positive,
        metavar="RUNS",
        help="runs per task, which are repeated if the worker is killed"
        f" (default: an eighth of a worker's share, at most {MAX_CHUNK})",
    )
    add(
        "--program",
        type=Path,
        default=PROGRAM,
        metavar="FILE",
        help="the native program (default: target/debug/cargo-fmu of this project)",
    )
    return parser.parse_args(words)


def main() -> int:
    """Run the script; return its exit status."""
    options = arguments()
    # Dask recovers from lost workers, and a lost scheduler is reported below.
    logging.disable()
    try:
        sweep(options)
    except SweepError as error:
        print(f"sweep.py: {error}", file=sys.stderr)
        return 1
    except FutureCancelledError:
        print("sweep.py: lost the scheduler; run the same command to resume", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("sweep.py: interrupted; run the same command to resume", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
