"""Instructions, memory accesses and cache misses, counted by valgrind.

They show what a cycle consists of, and do not depend on the load of the machine.
"""

import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from subjects import BENCH, PAIR, REFERENCE, Host, by_name, in_fmi3, standing

Counts = dict[str, float]

WARM_UP = 9 / 8
"""The C host takes an eighth of the cycles before it measures."""


def counts(host: Host, program: Path, fewer: int, more: int) -> dict[str, Counts]:
    """Count for a cycle or step of each subject, by the difference of runs of two lengths.

    Return nothing if there is no valgrind.
    """
    if not shutil.which("valgrind"):
        return {}
    cases = {"bare PID in C, move": REFERENCE}
    cases |= {f"{name}, move": by_name(name) for name in ("Pid", "PidRbf", "IpidRbf")}
    cases |= {"PidRbf, stand": standing(by_name("PidRbf")), "Pendulum": by_name("Pendulum, linear")}
    cases |= {f"{name}, FMI 3.0, move": in_fmi3(by_name(name)) for name in ("Pid", "PidRbf")}

    def per_step(command: Callable[[int], Sequence[str | Path]]) -> Counts:
        less, all_ = (counted(command(count)) for count in (fewer, more))
        return {name: max(all_[name] - less[name], 0) / (more - fewer) for name in all_}

    def cycle(count: int, name: str) -> list[str]:
        return host.command("cycle", round(count / WARM_UP), 1, [cases[name]])

    def natively(count: int) -> list[str | Path]:
        system = BENCH / "coupled.toml"
        return [program, "simulate", system, "--stop", f"{0.001 * (count + 0.5):.4f}"]

    results = {name: per_step(lambda count, name=name: cycle(count, name)) for name in cases}
    results["the coupled pair, by a master in C"] = per_step(
        lambda n: host.command("loop", n, 1, PAIR)
    )
    results["the coupled pair, natively"] = per_step(natively)
    return results


def counted(command: Sequence[str | Path]) -> Counts:
    """Run a command and count, in the process of it and its children that executes the most."""
    tool = ["valgrind", "--tool=callgrind", "--cache-sim=yes", "--callgrind-out-file=/dev/null"]
    result = subprocess.run(
        [*tool, "--trace-children=yes", *map(str, command)],
        capture_output=True,
        text=True,
        check=True,
    )
    totals = re.findall(r"Collected : ([\d ]+)", result.stderr)
    most = max(([int(number) for number in total.split()] for total in totals), key=lambda t: t[0])
    instructions, reads, writes, _, read_misses, write_misses, *_ = most
    return {
        "instructions": instructions,
        "accesses": reads + writes,
        "misses": read_misses + write_misses,
    }
