"""Measure the run times of the FMUs and the native master, and print the table of the README.

`make bench` runs it. Every comparison is a ratio of two measurements from the same run on the same
machine; the minimum of several repeats counts, since other processes only ever add time.
Results are written to target/bench: table.md, results.json, and speed.png with the plots.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import sysconfig
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

from pendulum_fmus.master import Component, System, simulate
from pendulum_fmus.project import FMUS, ROOT

PROGRAM = ROOT / "target" / "native" / "cargo-fmu"
OUT = ROOT / "target" / "bench"
CRITERION = ROOT / "target" / "criterion"
SWEEP = ROOT / "examples" / "sweep" / "gains.toml"

INPUTS = {
    "Pid": ["r", "y", "d"],
    "PidRbf": ["r", "y", "d"],
    "IpidRbf": ["r", "y", "d", "u_supervisor"],
    "Pendulum": ["u"],
    "CPid": ["r", "y", "d"],
    "PythonPid": ["r", "y", "d"],
}
"""Inputs that a cycle sets."""

HELD = {"r": 1.0, "d": 0.0, "u_supervisor": 10.0}
"""Constant inputs, as in a step response; the others change with every cycle."""

OUTPUTS = {"Pendulum": "theta"}
"""Outputs that a cycle reads; u of a controller."""


# --- measurements -------------------------------------------------------------------------


@dataclass(frozen=True)
class Unpacked:
    """An FMU unpacked for the C host."""

    model: str
    folder: Path

    def words(self) -> list[str]:
        """Return its arguments for the C host."""
        description = fmpy.read_model_description(str(self.folder), validate=False)
        references = {v.name: v.valueReference for v in description.modelVariables}
        identifier = description.coSimulation.modelIdentifier
        file = f"{identifier}{fmpy.sharedLibraryExtension}"
        binary = self.folder / "binaries" / fmpy.platform / file
        words = [
            f"name={self.model}",
            f"binary={binary}",
            f"guid={description.guid}",
            f"resources={(self.folder / 'resources').as_uri()}",
            f"out={references[OUTPUTS.get(self.model, 'u')]}",
        ]
        for name in INPUTS[self.model]:
            value = f":{HELD[name]}" if name in HELD else ""
            words.append(f"in={references[name]}{value}")
        return words


def unpack(file: Path, folder: Path) -> Unpacked:
    """Unpack an FMU into its own folder."""
    target = folder / file.stem
    with zipfile.ZipFile(file) as archive:
        archive.extractall(target)
    return Unpacked(file.stem, target)


def host(mode: str, count: int, repeats: int, fmus: Sequence[Unpacked]) -> list[dict]:
    """Run the C host, which measures the FMUs in turn."""
    words = [mode, str(count), str(repeats)]
    for index, fmu in enumerate(fmus):
        words += ["--"] * (index > 0) + fmu.words()
    lines = run([OUT / "cycle", *words], env=python_environment(fmus))
    return [json.loads(line) for line in lines.splitlines()]


def python_environment(fmus: Sequence[Unpacked]) -> dict[str, str]:
    """Return an environment in which PythonFMU's binary finds this Python."""
    if not any(fmu.model == "PythonPid" for fmu in fmus):
        return {}
    return {
        "LD_PRELOAD": str(python_library()),
        "PYTHONHOME": sys.base_prefix,
        "PYTHONPATH": sysconfig.get_path("purelib"),
    }


def python_library() -> Path | None:
    """Return the shared library of this Python, which PythonFMU's binary needs; None if missing."""
    folder, name = map(sysconfig.get_config_var, ("LIBDIR", "INSTSONAME"))
    library = Path(folder or "", name or "")
    return library if library.is_file() and ".so" in library.name else None


def run(command: Sequence[str | Path], env: Mapping[str, str] | None = None) -> str:
    """Run a program and return what it prints."""
    result = subprocess.run(
        list(map(str, command)),
        cwd=ROOT,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SystemExit(f"{command[0]} failed:\n{result.stdout}{result.stderr}")
    return result.stdout


def criterion(group: str, function: str) -> float:
    """Return the time [ns] of a Rust benchmark: the slope over its samples."""
    folder = CRITERION / group / function / "new"
    estimates = json.loads((folder / "estimates.json").read_text())
    return (estimates["slope"] or estimates["mean"])["point_estimate"]


def coupled(repeats: int) -> dict[str, float]:
    """Return the times [ns] of 20000 coupled steps of PID-RBF and plant, measured in turn."""
    masters = {"native": coupled_natively, "FMPy": coupled_by_fmpy}
    times = [{name: master() for name, master in masters.items()} for _ in range(repeats)]
    return {name: min(time[name] for time in times) for name in masters}


def coupled_natively() -> float:
    """Return the run time [ns] reported by the native master."""
    text = run([PROGRAM, "simulate", ROOT / "bench" / "coupled.toml"])
    return 1e6 * float(text.split(" s in ")[1].split(" ms")[0])


def coupled_by_fmpy() -> float:
    """Return the time [ns] of the same run with the FMPy master."""
    components = [
        Component("controller", FMUS / "PidRbf.fmu", {"r": 1.0}, sampled=True),
        Component("plant", FMUS / "Pendulum.fmu"),
    ]
    connections = [("plant.theta", "controller.y"), ("controller.u", "plant.u")]
    with System(components, connections) as system:
        begin = time.perf_counter_ns()
        simulate(system, 0.001, 0.001, 20_000, record=["controller.e"])
        return time.perf_counter_ns() - begin


def sweeps(folder: Path) -> Iterator[tuple[int, float]]:
    """Yield numbers of threads, and loops of 2000 steps per second."""
    for threads in range(1, (os.cpu_count() or 1) + 1):
        out = folder / f"{threads}.csv"
        text = run([PROGRAM, "sweep", SWEEP, "--threads", str(threads), "--out", out])
        yield threads, float(text.split(" runs in ")[1].split(": ")[1].split(" a second")[0])


def build(folder: Path) -> list[Unpacked]:
    """Build the C host and all FMUs; PythonFMU's only if it can run."""
    compiler = os.environ.get("CC", "cc")
    source = ROOT / "bench" / "cycle.c"
    run([compiler, "-O2", "-o", OUT / "cycle", source, "-ldl", "-lm"])
    run([sys.executable, ROOT / "examples" / "own-fmu" / "build.py", folder])
    files = [FMUS / f"{model}.fmu" for model in ("Pid", "PidRbf", "IpidRbf", "Pendulum")]
    files.append(folder / "CPid.fmu")
    if python_library():
        script = ROOT / "bench" / "python_pid.py"
        run([sys.executable, "-m", "pythonfmu", "build", "--file", script, "--dest", folder])
        files.append(folder / "PythonPid.fmu")
    return [unpack(file, folder) for file in files]


def measure(quick: bool) -> dict:
    """Measure everything."""
    OUT.mkdir(parents=True, exist_ok=True)
    # An unstable plant without a controller overflows after about 100000 steps.
    cycles, repeats = (10_000, 3) if quick else (20_000, 100)
    rust = ["--warm-up-time", "0.1", "--measurement-time", "0.2"] if quick else []
    results: dict = {}
    with TemporaryDirectory(dir=OUT) as name:
        folder = Path(name)
        fmus = {fmu.model: fmu for fmu in build(folder)}
        ours = [fmus[model] for model in ("Pid", "PidRbf", "IpidRbf", "Pendulum")]
        say("cycles through the C interface")
        results["cycle"] = host("cycle", cycles, repeats, [*ours, fmus["CPid"]])
        if "PythonPid" in fmus:
            pair = [fmus["Pid"], fmus["PythonPid"]]
            results["python"] = host("cycle", cycles // 20, max(repeats // 5, 3), pair)
        say("instances")
        all_fmus = [*ours, fmus["CPid"]]
        results["life"] = host("life", 1000 if quick else 10_000, max(repeats // 5, 3), all_fmus)
        results["many"] = host("many", 5 * cycles, max(repeats // 5, 3), all_fmus)
        say("in process, loading")
        bench = ["cargo", "bench", "--quiet", "--profile", "native", "--package", "fmu-cosim"]
        run([*bench, "--bench", "speed", "--", *rust])
        say("coupled runs")
        results["coupled"] = coupled(2 if quick else 10)
        say("sweeps and Table 1")
        results["sweeps"] = list(sweeps(folder))
    results["sizes"] = {file.stem: file.stat().st_size for file in sorted(FMUS.glob("*.fmu"))}
    return results


def say(what: str) -> None:
    """Print the current measurement."""
    print(f"measuring: {what}", file=sys.stderr)


# --- results ------------------------------------------------------------------------------


def rows(results: Mapping) -> Iterator[tuple[str, str, str, str]]:
    """Yield the rows of the table: subject, measurement, reference, ratio."""
    cycle = {line["fmu"]: line["min_ns"] for line in results["cycle"]}
    yield (
        "`Pid`, a cycle from C",
        ns(cycle["Pid"]),
        f"bare PID in C: {ns(cycle['CPid'])}",
        ratio(cycle["Pid"], cycle["CPid"]),
    )
    if "python" in results:
        python = {line["fmu"]: line["min_ns"] for line in results["python"]}
        yield (
            "`Pid`, a cycle from C",
            ns(python["Pid"]),
            f"PythonFMU: {ns(python['PythonPid'])}",
            ratio(python["Pid"], python["PythonPid"]),
        )
    for model in ("Pid", "PidRbf", "IpidRbf", "Pendulum"):
        inside = criterion(model, "in process")
        more = f"{cycle[model] - inside:+.1f} ns"
        yield f"`{model}`, a cycle from C", ns(cycle[model]), f"in process: {ns(inside)}", more
    native, by_fmpy = results["coupled"]["native"], results["coupled"]["FMPy"]
    yield (
        "plant and `PidRbf`, 20000 steps, native master",
        ns(native),
        f"FMPy: {ns(by_fmpy)}",
        ratio(native, by_fmpy),
    )
    rates = dict(results["sweeps"])
    for threads, rate in rates.items():
        against = f"1 thread: {rates[1]:.0f}" if threads > 1 else ""
        yield (
            f"sweep, {threads} thread{'s' * (threads > 1)}",
            f"{rate:.0f} loops of 2000 steps a second",
            against,
            f"{rate / rates[1]:.2f} times" if threads > 1 else "",
        )
    life = {line["fmu"]: line for line in results["life"]}
    for model in ("Pid", "PidRbf", "Pendulum"):
        line = life[model]
        yield (
            f"`{model}`, instantiate to free",
            f"{ns(line['min_ns'])}, {line['initialized_bytes']:.0f} B",
            f"bare PID in C: {ns(life['CPid']['min_ns'])}, {life['CPid']['bytes']:.0f} B",
            ratio(line["min_ns"], life["CPid"]["min_ns"]),
        )
    yield "open and unpack an FMU", ns(criterion("loading", "open")), "", ""
    largest = max(results["sizes"].values())
    yield "largest .fmu", f"{largest / 1000:.0f} KB", "", ""


def ns(time: float) -> str:
    """Return a time in ns with a suitable unit."""
    for unit, factor in (("ns", 1.0), ("µs", 1e3), ("ms", 1e6)):
        if time < 1000 * factor:
            return f"{time / factor:.3g} {unit}"
    return f"{time / 1e9:.3g} s"


def ratio(ours: float, other: float) -> str:
    """Return the ratio of two costs as text."""
    return f"{ours / other:.2f} times" if ours > other else f"1/{other / ours:.0f}"


def table(results: Mapping) -> str:
    """Return the table as Markdown."""
    head = ("what", "measured", "against", "ratio")
    lines = [head, ("---",) * 4, *rows(results)]
    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"{body}\n\nMeasured on {machine}, Python {platform.python_version()}.\n"


def plot(results: Mapping, file: Path) -> None:
    """Draw the cost over the numbers of nodes and instances."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    nodes = [1, 4, 16, 64, 256]
    for kind, marker in (("constant", "o"), ("moving", "s")):
        times = [criterion("nodes", f"{n} {kind}") for n in nodes]
        left.loglog(nodes, times, marker=marker, label=f"{kind} set-point")
    left.set(xlabel="nodes of the network", ylabel="time per sample in process [ns]")
    for model, marker in zip(("Pid", "PidRbf", "Pendulum", "CPid"), "osd^", strict=True):
        lines = [line for line in results["many"] if line["fmu"] == model]
        counts, times = zip(*((line["instances"], line["min_ns"]) for line in lines), strict=True)
        label = "bare PID in C" if model == "CPid" else model
        right.semilogx(counts, times, marker=marker, label=label)
    right.set(
        xlabel="instances, stepped in turn", ylabel="time per cycle from C [ns]", ylim=(0, None)
    )
    for axes in (left, right):
        axes.grid(visible=True, which="both", alpha=0.3)
    left.legend()
    right.legend(loc="lower right", ncols=2)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description="Measure the FMUs and the native master.")
    parser.add_argument("--quick", action="store_true", help="few repeats, to check that it works")
    options = parser.parse_args()
    results = measure(options.quick)
    (OUT / "results.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    text = table(results)
    (OUT / "table.md").write_text(text, encoding="utf-8")
    plot(results, OUT / "speed.png")
    print(text)


if __name__ == "__main__":
    main()
