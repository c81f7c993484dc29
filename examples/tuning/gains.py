"""Find gains with a smaller integral of |e| than those of the paper, at the same force limit.

Each of a step, a sine and a square wave has to be better. What is found keeps the pendulum upright
for masses and a length that differ by 20 % as well. Needs `make fmus` and `make module`.
"""

import argparse
import itertools
import math
import time
from pathlib import Path

from fmu_master import Result, System
from fmu_master.tuning import integral_of_absolute, tune

LOOPS = Path(__file__).parents[1] / "closed-loop"
FREQUENCIES = {"step": 0.1, "sine": 0.2, "square": 0.1}
"""Those of the paper [Hz]; a step has none."""

SIGNALS = [{"source.signal": s, "source.frequency": f} for s, f in FREQUENCIES.items()]
NOMINAL = {"plant.M": 1.096, "plant.m": 0.109, "plant.l": 0.25}
PLANTS = [
    {name: value * factor for (name, value), factor in zip(NOMINAL.items(), factors, strict=True)}
    for factors in itertools.product((0.8, 1.2), repeat=3)
]
GAINS = {
    "controller.pid.kp": (100.0, 3000.0, 300.0),
    "controller.pid.ki": (50.0, 5000.0, 500.0),
    "controller.pid.kd": (20.0, 500.0, 100.0),
    "controller.rbf.eta": (0.03, 1.0, 0.3),
}
"""Smallest and largest gain, and the one of the paper."""


def errors(results: list[Result]) -> list[float]:
    """Return the integral of |e| for each signal [rad s]."""
    return [integral_of_absolute(result, "controller.e") for result in results]


def is_stable(result: Result) -> bool:
    """Whether the error ends below 0.05 rad and stays there for the last 2 s."""
    return bool(max(abs(result["controller.e"][-2000:]), default=math.inf) < 0.05)


def main() -> None:
    """Search the gains of both controllers and print how they compare with those of the paper."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("controllers", nargs="*", default=["pid-rbf", "ipid-rbf"], metavar="LOOP")
    parser.add_argument("--generations", type=int, default=2, help="how long to search")
    parser.add_argument("--journal", type=Path, help="folder of the files to continue from")
    parser.add_argument("--out", type=Path, help="TOML file to keep the gains in")
    options = parser.parse_args()
    kept = ""
    for name in options.controllers:
        system, begin = System(LOOPS / f"{name}.toml"), time.monotonic()
        shown = {"output": ["controller.e"], "in_process": True}
        paper = errors([system.simulate(signal, **shown) for signal in SIGNALS])
        found = tune(
            system,
            {gain: (low, high) for gain, (low, high, _) in GAINS.items()},
            # The worst signal counts: each has to be better.
            lambda results, paper=paper: max(
                own / other for own, other in zip(errors(results), paper, strict=True)
            ),
            cases=SIGNALS,
            plants=PLANTS,
            accepts=is_stable,
            guess={gain: start for gain, (_, _, start) in GAINS.items()},
            generations=options.generations,
            journal=options.journal and options.journal / f"{name}.journal",
            **shown,
        )
        own = errors([system.simulate(signal | found.values, **shown) for signal in SIGNALS])
        print(f"{name}: {found.evaluations} candidates in {time.monotonic() - begin:.0f} s")
        kept += f"[{name}]\n"
        for gain, value in found.values.items():
            print(f"  {gain} = {value:.4g}")
            kept += f'"{gain}" = {value!r}\n'
        for signal, before, after in zip(SIGNALS, paper, own, strict=True):
            kind = signal["source.signal"]
            print(f"  {kind}: integral of |e| {before:.4g} -> {after:.4g} rad s")
    if options.out:
        options.out.write_text(f"# Found by examples/tuning/gains.py\n{kept}", encoding="utf-8")


if __name__ == "__main__":
    main()
