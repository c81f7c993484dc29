"""Run a sweep on many processes or machines with Dask.

The rows are the same as from `cargo fmu sweep`, byte for byte. With one process per core:

    python -m pendulum_fmus.sweep examples/sweep/gains.toml --out target/gains.csv

On several machines of the same platform, start a scheduler on one and workers on each:

    dask scheduler --host HOST
    dask worker tcp://HOST:8786 --nworkers auto --nthreads 1

Then add `--scheduler tcp://HOST:8786` to the command. The workers need the same version of
`dask.distributed`, but nothing of this project: each receives the program, the sweep, the system
and the FMUs.

A killed sweep resumes when the same command is run again, and so does `cargo fmu sweep`: both keep
their rows in a journal, the name of the table with the suffix `.part`.

Dask executes any code that it receives: whoever can reach the scheduler can run any program on its
workers, and a worker can send anything to the coordinator. Use a trusted network or Dask's TLS.
"""

import argparse
import contextlib
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import CancelledError
from pathlib import Path
from subprocess import PIPE, Popen

from tqdm import tqdm

from pendulum_fmus.project import PROGRAM, extra

with extra("dask"):
    import dask
    from dask.distributed import Client, KilledWorker, as_completed, get_worker
    from distributed.comm import CommClosedError

PROG = "python -m pendulum_fmus.sweep"

LONGEST = 1000
"""Maximum number of runs in a task, which are repeated if its worker is killed."""

LOCAL = {
    "threads_per_worker": 1,
    "host": "127.0.0.1",
    "dashboard_address": None,
    "silence_logs": logging.CRITICAL,
    # The coordinator reacts to Ctrl-C and reports errors.
    "preload": "import os, signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    "os.dup2(os.open(os.devnull, os.O_WRONLY), 2)",
}
"""Settings of the workers on this machine."""


def files_of(program: Path, sweep: Path, system: str, fmus: list[str]) -> dict[str, bytes]:
    """Return what a worker needs, by the names in its folder."""
    files = {"cargo-fmu": program, "sweep.toml": sweep, "system.toml": Path(system)}
    for fmu in map(Path, fmus):
        other = files.setdefault(fmu.name, fmu)
        if other.read_bytes() != fmu.read_bytes():
            raise OSError(f"{other} and {fmu} are different FMUs; give them different names")
    return {name: file.read_bytes() for name, file in files.items()}


def rows(files: dict[str, bytes], first: int, end: int) -> bytes:
    """Return the rows of some runs, simulated on the current worker."""
    # Dask removes what a killed worker leaves in this folder.
    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as folder:
        for name, content in files.items():
            Path(folder, name).write_bytes(content)
        (program := Path(folder, "cargo-fmu")).chmod(0o700)
        options = "sweep sweep.toml --system system.toml --fmus . --threads 1".split()
        command = [program, *options, f"--rows={first}..{end}"]
        env = {**os.environ, "TMPDIR": folder}
        done = subprocess.run(command, cwd=folder, env=env, capture_output=True, check=False)
    if done.returncode:
        said = done.stderr.decode().removeprefix("error: ").strip()
        raise ChildProcessError(said or f"the program ended with code {done.returncode}")
    return done.stdout


def compute(client: Client, files: dict[str, bytes], missing: list, collector: Popen) -> None:
    """Simulate the missing runs, and pass their rows on."""
    begin, left = time.monotonic(), sum(end - first for first, end in missing)
    threads = sum(client.nthreads().values())
    if not threads:
        print(f"no worker yet; `dask worker {client.scheduler.address}` starts one", flush=True)
    # Each thread gets several tasks, since some take longer.
    size = max(1, min(left // (8 * max(threads, 1)), LONGEST))
    tasks = [(k, min(k + size, end)) for first, end in missing for k in range(first, end, size)]
    # A result, unlike data, is computed again if the worker that has it is killed.
    sent = client.submit(dict, files)
    futures = {client.submit(rows, sent, *task, retries=3): task for task in tasks}
    with tqdm(total=left, unit="run", leave=False, disable=None) as bar:
        for future in as_completed(futures):
            collector.stdin.write(future.result())
            collector.stdin.flush()
            first, end = futures[future]
            bar.update(end - first)
    seconds = time.monotonic() - begin
    print(f"{left} runs in {seconds:.3f} s: {left / seconds:.0f} a second")


def sweep(options: argparse.Namespace) -> int:
    """Run the sweep of the command line; the program keeps the journal. Return the exit status."""
    out = ["--out", options.out] if options.out else []
    command = [options.program.resolve(), "sweep", options.sweep, "--collect", *out]
    settings = {} if options.scheduler else LOCAL
    with Popen(command, stdin=PIPE, stdout=PIPE) as collector:
        if outline := collector.stdout.readline():
            plan, missing = json.loads(outline)
            files = files_of(command[0], options.sweep, plan["system"], plan["fmus"])
            with (
                dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}),
                Client(options.scheduler, **settings) as client,
                contextlib.suppress(BrokenPipeError),  # the program says why it ended
            ):
                compute(client, files, missing, collector)
        said, _ = collector.communicate()
    print(said.decode(), end="")
    return collector.returncode


def main() -> int:
    """Run the script; return its exit status."""
    about = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(PROG, description=__doc__, formatter_class=about)
    add = parser.add_argument
    # fmt: off
    add("sweep", type=Path, metavar="SWEEP.toml", help="sweep file")
    add("--out", type=Path, metavar="FILE",
        help="output file, .csv or .parquet (default: the name of the sweep file with .csv)")
    add("--scheduler", metavar="tcp://HOST:PORT",
        help="scheduler whose workers execute the runs (default: workers on this machine)")
    add("--program", type=Path, default=PROGRAM, metavar="FILE",
        help="the program (default: %(default)s)")
    # fmt: on
    options = parser.parse_args()
    if not options.program.is_file():
        parser.error(f"there is no {options.program}; `make fmus` builds it")
    logging.disable()  # Dask recovers from lost workers; a lost scheduler is reported here
    try:
        return sweep(options)
    except KeyboardInterrupt:
        message, status = "interrupted; run the same command to resume", 130
    except (CancelledError, CommClosedError):
        message, status = "lost the scheduler; run the same command to resume", 1
    except (KilledWorker, OSError) as error:
        message, status = str(error), 1
    print(f"error: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
