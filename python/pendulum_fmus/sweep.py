"""Run a sweep on many processes or machines with Dask.

The rows are the same as from `cargo fmu sweep`, byte for byte. With one process per core:

    python -m pendulum_fmus.sweep examples/sweep/gains.toml --out target/gains.csv

On several machines of the same platform, start a scheduler on one and workers on each:

    dask scheduler --host HOST
    dask worker tcp://HOST:8786 --nworkers auto --nthreads 1

Then add `--scheduler tcp://HOST:8786` to the command. The workers need the same version of
`dask.distributed`, but nothing of this project: each receives the native module, the sweep, the
system and the FMUs.

A killed sweep resumes when the same command is run again, and so does `cargo fmu sweep`: both keep
their rows in a journal, the name of the table with the suffix `.part`.

Dask executes any code that it receives: whoever can reach the scheduler can run any program on its
workers, and a worker can send anything to the coordinator. Use a trusted network or Dask's TLS.
"""

import argparse
import logging
import os
import signal
import sys
from concurrent.futures import CancelledError
from pathlib import Path
from threading import Timer

from pendulum_fmus.project import extra

with extra("dask"):
    import dask  # noqa: F401 - named if it is missing
    from dask.distributed import Client, KilledWorker
    from distributed.comm import CommClosedError

    from fmu_master._dask import distribute

PROG = "python -m pendulum_fmus.sweep"

LOCAL = {
    "threads_per_worker": 1,
    "host": "127.0.0.1",
    # Without an address, Dask's HTTP server listens on port 8787 of all network interfaces.
    "dashboard_address": "127.0.0.1:0",
    "scheduler_kwargs": {"dashboard": False},
    "silence_logs": logging.CRITICAL,
    # The coordinator reacts to Ctrl-C and reports errors.
    "preload": "import os, signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    "os.dup2(os.open(os.devnull, os.O_WRONLY), 2)",
}
"""Settings of the workers on this machine."""


def sweep(options: argparse.Namespace) -> int:
    """Run the sweep of the command line; the program keeps the journal. Return the exit status."""
    arguments = [str(options.sweep), *(["--out", str(options.out)] if options.out else [])]
    settings = {} if options.scheduler else LOCAL
    program = options.program and options.program.resolve()
    code, said, _ = distribute(
        arguments, lambda: Client(options.scheduler, **settings), program, None
    )
    print(said, end="")
    return code


def interrupt_again(ignored: "sys.UnraisableHookArgs") -> None:
    """Interrupt this process once more if Python has ignored the first interrupt.

    Python ignores exceptions in the callbacks of its garbage collection, one of which is Dask's.
    """
    if ignored.exc_type is KeyboardInterrupt:
        Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(ignored)


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
    add("--program", type=Path, metavar="FILE",
        help="a program `cargo-fmu` (default: that of the module fmu_master)")
    # fmt: on
    options = parser.parse_args()
    if options.program and not options.program.is_file():
        parser.error(f"there is no {options.program}; `make fmus` builds it")
    sys.unraisablehook = interrupt_again
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
