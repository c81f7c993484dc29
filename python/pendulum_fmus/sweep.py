"""Run a sweep on many processes or machines, by Dask.

The rows are those of `cargo fmu sweep`, byte for byte. With one process for each core:

    python -m pendulum_fmus.sweep examples/sweep/gains.toml --out target/gains.csv

On several machines of the same platform, start on one of them, and then on each that is to work,

    dask scheduler --host HOST
    dask worker tcp://HOST:8786 --nworkers auto --nthreads 1

and add `--scheduler tcp://HOST:8786` to the command. The workers need `dask.distributed` in the
same version, and nothing of this project: each gets the native program, the sweep, the system and
the FMUs, in a folder that goes away with it.

A sweep that was killed goes on where it was when the same command is given again, or `cargo fmu
sweep`, which keeps the same journal: the table's name with `.part` behind it.

Dask runs what it is sent: whoever reaches the scheduler can run any program on its workers, and a
worker can send anything to the coordinator. Use it in a network that you trust, or with Dask's TLS.
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

PATIENCE = 5
"""How long a scheduler may take to answer [s]."""

RETRIES = 3
"""How often a chunk is tried again whose program was killed on its worker."""

PRELOAD = """
import os, signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
"""
"""Local workers leave it to the coordinator to end them, and to say why."""

AHEAD = 1000
"""Most chunks that the scheduler knows of: enough for that many workers, few for its memory."""

LARGEST_CHUNK = 1000
"""Runs of a chunk at most, by default: what a killed worker may have to do again."""


class SweepError(Exception):
    """What ends the sweep, in words for the user."""


# --- the sweep ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """A sweep, as the program sees it.

    Parameters
    ----------
    runs
        How many there are.
    header
        The first lines of the journal.
    files
        What a worker needs, by paths in its folder.
    """

    runs: int
    header: bytes
    files: dict[str, bytes]


def call(program: Path, *arguments: object) -> str:
    """Run `cargo fmu sweep` on this machine; returns what it prints."""
    command = [program, "sweep", *map(str, arguments)]
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise SweepError(
            f"cannot run {program}: {error.strerror}; `make native` builds the program"
        ) from error
    if result.returncode:
        raise SweepError(complaint(result.stderr, result.returncode))
    return result.stdout


def complaint(stderr: str, code: int) -> str:
    """Return what the program said when it failed."""
    return stderr.removeprefix("error: ").strip() or f"the program ended with exit code {code}"


def read_plan(program: Path, sweep: Path) -> Plan:
    """Ask the program for the plan, and read the files that it names."""
    plan = json.loads(call(program, sweep, "--plan"))
    files = {"cargo-fmu": program, "sweep.toml": sweep, "system.toml": Path(plan["system"])}
    for fmu in dict.fromkeys(map(Path, plan["fmus"])):
        # Workers take the FMUs from one folder, by their file names.
        other = files.setdefault(f"fmus/{fmu.name}", fmu)
        if other.read_bytes() != fmu.read_bytes():
            raise SweepError(f"{other} and {fmu} are different FMUs; give them different names")
    contents = {name: path.read_bytes() for name, path in files.items()}
    return Plan(plan["runs"], plan["header"].encode(), contents)


# --- the journal --------------------------------------------------------------------------------


class Journal:
    """The rows that are done, in the format of sweep/src/journal.rs; locked until it is closed."""

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
        """Cut what a kill tore: the last line, or all if that is the header; returns the rest."""
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
                raise OSError(0, "only a part was written")
            os.fsync(self.file.fileno())
        except OSError as error:
            self.file.truncate(self.length)
            raise SweepError(f"cannot write {self.path}: {error.strerror}") from error
        self.length += len(lines)

    def close(self) -> None:
        """Give the journal to others."""
        self.file.close()


def lines_of(text: bytes) -> list[bytes]:
    """Return the lines, without the line feed behind each."""
    return text.split(b"\n")[:-1]


def run_of(line: bytes) -> int:
    """Return the number of the run that a line is of."""
    return int(line.split(b",", 1)[0])


def check_rows(rows: bytes, chunk: range) -> None:
    """Refuse rows that are not those of a chunk, each once."""
    if not rows.endswith(b"\n") or sorted(map(run_of, lines_of(rows))) != list(chunk):
        raise SweepError(f"a worker gave other rows than {named(chunk)}")


def chunks(runs: int, done: set[int], size: int) -> Iterator[range]:
    """Yield the runs that are left, in ranges of at most `size`."""
    first = 0
    for end in [*sorted(done), runs]:
        yield from (range(k, min(k + size, end)) for k in range(first, end, size))
        first = end + 1


def named(chunk: range) -> str:
    """Return a chunk as the messages show it."""
    return f"the runs {chunk.start}..{chunk.stop}"


# --- workers ------------------------------------------------------------------------------------


class Bundle(WorkerPlugin):
    """The files of a sweep in a folder of a worker. Workers that come later get it too."""

    idempotent = True  # Of another coordinator for the same files, killed before it took them back.

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
    """Run the program for a chunk of runs, on the worker that this is called on."""
    folder = get_worker().plugins[bundle].folder
    command = [
        folder / "cargo-fmu", "sweep", folder / "sweep.toml",
        "--system", folder / "system.toml", "--fmus", folder / "fmus",
        "--rows", f"{chunk.start}..{chunk.stop}", "--threads", "1",
    ]  # fmt: skip
    # The FMUs are unzipped there, so that they go away with the worker too.
    environment = {**os.environ, "TMPDIR": str(folder)}
    result = subprocess.run(command, env=environment, capture_output=True, check=False)
    if result.returncode < 0:
        raise ChildProcessError(f"the program was ended by signal {-result.returncode}")
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
            client = Client(scheduler, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise SweepError(
                f"no scheduler answers at {scheduler}; `dask scheduler` starts one"
            ) from error
        yield stack.enter_context(client)


@contextlib.contextmanager
def sent(client: Client, bundle: Bundle) -> Iterator[str]:
    """Have all workers unpack the bundle, and at last remove it; yields its name."""
    client.register_plugin(bundle, name=bundle.name)
    try:
        yield bundle.name
    finally:
        # Without the scheduler there is nobody to take it back from.
        with contextlib.suppress(Exception):
            client.unregister_worker_plugin(bundle.name)


def results(client: Client, bundle: str, chunks: Iterable[range]) -> Iterator[tuple[range, bytes]]:
    """Have the workers do the chunks; yields each with its rows, in any order."""
    group = f"rows-{uuid.uuid4().hex}"
    chunks = iter(chunks)

    def submit(chunk: range):
        key = (group, chunk.start, chunk.stop)
        return client.submit(simulate, bundle, chunk, key=key, retries=RETRIES)

    pending = as_completed(map(submit, islice(chunks, AHEAD)))
    for future in pending:
        chunk = range(*future.key[1:])
        try:
            result = future.result()
        except KilledWorker as error:
            raise SweepError(f"{named(chunk)} end every worker that does them") from error
        except OSError as error:
            raise SweepError(
                f"a worker failed at {named(chunk)}: {error}; is it of the same platform?"
            ) from error
        if result.returncode:
            raise SweepError(complaint(result.stderr.decode(), result.returncode))
        yield chunk, result.stdout
        pending.update(map(submit, islice(chunks, 1)))


# --- the script ---------------------------------------------------------------------------------


def default_chunk(runs: int, threads: int) -> int:
    """Return a size of chunks that keeps all threads busy to the end."""
    return max(1, min(runs // (8 * max(1, threads)), LARGEST_CHUNK))


def compute(client: Client, plan: Plan, journal: Journal, size: int | None) -> None:
    """Do the runs that are left, and append their rows to the journal."""
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
    """Run the sweep that the command line asks for."""
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
    """Read a whole number of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m pendulum_fmus.sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("sweep", type=Path, metavar="SWEEP.toml", help="file that describes the sweep")
    add(
        "--out",
        type=Path,
        metavar="FILE",
        help="file for the rows, .csv or .parquet (default: the sweep's name with .csv)",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="scheduler whose workers do the runs (default: workers on this machine)",
    )
    where.add_argument(
        "--workers",
        type=positive,
        metavar="N",
        help="worker processes on this machine (default: one for each core)",
    )
    add(
        "--chunk",
        type=positive,
        metavar="RUNS",
        help="runs that a worker does at a time, and that are lost with it if it is killed"
        f" (default: an eighth of its share, {LARGEST_CHUNK} at most)",
    )
    add(
        "--program",
        type=Path,
        default=PROGRAM,
        metavar="FILE",
        help="the native program (default: target/native/cargo-fmu of this project)",
    )
    return parser.parse_args(words)


def main() -> int:
    """Run the script; returns its exit status."""
    options = arguments()
    # What they say of lost workers and schedulers is said here, or mended by Dask.
    logging.disable()
    try:
        sweep(options)
    except SweepError as error:
        print(f"sweep.py: {error}", file=sys.stderr)
        return 1
    except FutureCancelledError:
        print("sweep.py: the scheduler is lost; the same command goes on", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("sweep.py: interrupted; the same command goes on", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
