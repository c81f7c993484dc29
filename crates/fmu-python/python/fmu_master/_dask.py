"""Sweeps on Dask: the workers simulate, the program of this machine keeps the journal."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from subprocess import PIPE, Popen

import cloudpickle
import dask
from dask.distributed import Client, as_completed, get_worker
from tqdm import tqdm

from ._command import COMMAND, MODULE, PROGRAM, command

# The workers need not have this module.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

LONGEST = 1000
"""Maximum number of runs in a task, which are repeated if its worker is killed."""


def files_of(programs: list[Path], sweep: Path, others: list[tuple[str, str]]) -> dict[str, bytes]:
    """Return what a worker needs, by the paths in its folder."""
    files = {program.name: program for program in programs} | {"sweep.toml": sweep}
    for place, file in others:
        if ".." in Path(place).parts:
            raise OSError(f"{file} is outside of the folder of the system, expected it inside")
        other = files.setdefault(place, Path(file))
        if other.read_bytes() != Path(file).read_bytes():
            raise OSError(f"{other} and {file} are different files; give them different names")
    return {name: file.read_bytes() for name, file in files.items()}


def rows(files: dict[str, bytes], program: list[str], first: int, end: int) -> bytes:
    """Return the rows of some runs, simulated on the current worker by its Python."""
    # Dask removes what a killed worker leaves in this folder.
    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as folder:
        for name, content in files.items():
            Path(folder, name).parent.mkdir(parents=True, exist_ok=True)
            Path(folder, name).write_bytes(content)
            Path(folder, name).chmod(0o700)
        words = [word or sys.executable for word in program]
        words += [f"--rows={first}..{end}"]
        env = {**os.environ, "TMPDIR": folder}
        done = subprocess.run(words, cwd=folder, env=env, capture_output=True, check=False)
    if done.returncode:
        said = done.stderr.decode().removeprefix("error: ").strip()
        raise ChildProcessError(said or f"the program ended with code {done.returncode}")
    return done.stdout


def compute(
    client: Client, files: dict[str, bytes], program: list[str], missing: list, collector: Popen
) -> None:
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
    futures = {client.submit(rows, sent, program, *task, retries=3): task for task in tasks}
    with tqdm(total=left, unit="run", leave=False, disable=None) as bar:
        for future in as_completed(futures):
            collector.stdin.write(future.result())
            collector.stdin.flush()
            first, end = futures[future]
            bar.update(end - first)
    seconds = time.monotonic() - begin
    print(f"{left} run{'s' * (left != 1)} in {seconds:.3f} s: {left / seconds:.0f} a second")


def distribute(
    arguments: list[str],
    connect: Callable[[], AbstractContextManager[Client]],
    program: Path | None = None,
    errors: int | None = PIPE,
) -> tuple[int, str, str]:
    """Run `sweep` with these arguments, the first of which is the sweep file, on Dask.

    `connect` is called once the plan is valid. `program` is a program to use and to send to the
    workers, by default the native module. Returns the exit code, and what was printed; `errors`
    says where errors go, as for Popen.
    """
    collect = COMMAND if program is None else [str(program)]
    local = [f"./{program.name}"] if program else command(Path(), "")
    local += ["sweep", "sweep.toml", "--fmus=.", "--threads=1"]
    collect = [*collect, "sweep", *arguments, "--collect"]
    with Popen(collect, stdin=PIPE, stdout=PIPE, stderr=errors) as collector:
        if outline := collector.stdout.readline():
            plan, missing = json.loads(outline)
            sent = [program] if program else [MODULE, PROGRAM]
            files = files_of(sent, Path(arguments[0]), plan["files"])
            local += [f"--{key}={plan[key]}" for key in ("system", "input") if plan[key]]
            with (
                dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"}),
                connect() as client,
                contextlib.suppress(BrokenPipeError),  # the program says why it ended
            ):
                compute(client, files, local, missing, collector)
        said, reported = collector.communicate()
    return collector.returncode, said.decode(), (reported or b"").decode()
