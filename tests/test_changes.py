"""A model in service, and its successor on the page of changes, in the hosts of the first one."""

import re
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest

from native import call, prepare, run
from pendulum_fmus.project import PROGRAM, ROOT

MANIFEST = f"""[package]
name = "heater"
version = "1.0.0"
edition = "2024"

[lib]
crate-type = ["cdylib"]

[dependencies]
fmu-export = {{ path = "{ROOT}/crates/fmu-export" }}

[workspace]
"""

FIRST = """use fmu_export::prelude::*;

/// Heater with a thermostat
#[derive(Model)]
#[model(sample_time = 1, step_size = 1)]
pub struct Heater {
    /// temperature
    #[input(unit = "K", start = 293)]
    t: f64,
    /// heat
    #[output(unit = "W")]
    q: f64,
    /// gain
    #[parameter(start = 500, unit = "W/K")]
    k: f64,
    /// set-point
    #[parameter(tunable, start = 295, unit = "K")]
    target: f64,
}

impl Simulate for Heater {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        self.q = self.k * (self.target - self.t);
        Ok(())
    }
}
"""

SYSTEM = """stop = 5
step = 1
outputs = ["heater.q", "wall.q"]

[[component]]
name = "heater"
fmu = "Heater.fmu"
start = { k = 100, target = 300 }

[[component]]
name = "wall"
fmu = "Heater.fmu"

[[connections]]
from = "heater.q"
to = "wall.t"
factor = 0.4
"""


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Export the first version; the second one, for both versions of FMI; and one with its GUID."""
    package = tmp_path_factory.mktemp("heater")
    (package / "src").mkdir()
    (package / "Cargo.toml").write_text(MANIFEST)
    page = (ROOT / "docs" / "changes.md").read_text(encoding="utf-8")
    second = re.findall(r"```rust\n(.*?)```", page, re.DOTALL)[0]
    prepare(package)
    for name, text, options in (
        ("first", FIRST, ["--fmi", "2.0"]),
        ("second", second, ["--fmi", "2.0,3.0"]),
        ("named", second, ["--fmi", "2.0", "--guid", "version"]),
    ):
        (package / "src" / "lib.rs").write_text(text + "\nexport!(Heater);\n")
        done = call([PROGRAM, "export", *options, "--out", package / name], package)
        assert done.returncode == 0, done.stderr
    return package.joinpath


SUCCESSORS = ["second/Heater.fmu", "second/Heater_fmi3.fmu", "named/Heater.fmu"]


@pytest.mark.parametrize("successor", SUCCESSORS)
def test_a_script_for_fmpy_has_the_same_results(
    versions: Callable[[str], Path], successor: str
) -> None:
    times = [(0.0, 293.0), (3.0, 296.0), (5.0, 290.0)]
    signals = np.array(times, dtype=[("time", np.double), ("t", np.double)])
    start = {"k": 100.0, "target": 300.0}

    def results(fmu: Path) -> np.ndarray:
        return fmpy.simulate_fmu(
            fmu, start_values=start, input=signals, output=["q"], stop_time=5, output_interval=1
        )

    first, second = (results(versions(name)) for name in ("first/Heater.fmu", successor))
    assert first.dtype == second.dtype
    assert np.array_equal(first, second)
    # k (target - t) of the sample at the start of the last step, in which t is between 296 and 290.
    assert second["q"][-1] == pytest.approx(100 * (300 - 293))


@pytest.mark.parametrize("successor", SUCCESSORS)
def test_a_system_and_options_have_the_same_results(
    versions: Callable[[str], Path], successor: str, tmp_path: Path
) -> None:
    table = tmp_path / "table.csv"
    table.write_text("time,heater.t\n0,293\n5,290\n")
    columns = []
    for number, name in enumerate(("first/Heater.fmu", successor)):
        (system := tmp_path / f"{number}.toml").write_text(
            SYSTEM.replace("Heater.fmu", str(versions(name)))
        )
        csv = system.with_suffix(".csv")
        done = run(
            "simulate", system, "--set", "wall.k=3", "--input", table, "--csv", csv, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr
        noted = "note: heater.target is deprecated: connect an input from version 3 on"
        assert (noted in done.stdout + done.stderr) == (number == 1)
        columns.append(csv.read_text(encoding="utf-8"))
    assert columns[0] == columns[1]


def test_new_names_work_where_the_standard_allows_it(
    versions: Callable[[str], Path], tmp_path: Path
) -> None:
    for name in SUCCESSORS:
        csv = tmp_path / "new.csv"
        options = ["--set", "kp=200", "--output", "heat", "--stop", "2", "--step", "1"]
        done = run("simulate", versions(name), *options, "--csv", csv)
        assert done.returncode == 0, done.stderr
        assert csv.read_text(encoding="utf-8").splitlines()[-1].endswith(",400.0")
    result = fmpy.simulate_fmu(
        versions("second/Heater_fmi3.fmu"), start_values={"kp": 200.0}, stop_time=2
    )
    assert result["heat"][-1] == 400.0


def test_the_successor_has_no_findings_and_breaks_no_names(
    versions: Callable[[str], Path],
) -> None:
    first = versions("first/Heater.fmu")
    for name in SUCCESSORS[:2]:
        done = run("validate", versions(name))
        assert done.stdout.endswith("no error, no warning\n"), done.stdout
    done = run("diff", first, versions("second/Heater.fmu"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "kp: another name of k\n" in done.stdout
    done = run("diff", versions("second/Heater.fmu"), first)
    assert done.returncode == 1
    assert "  kp: removed\n" in done.stdout


def test_the_guid_follows_from_the_version_on_demand(versions: Callable[[str], Path]) -> None:
    """In both versions of FMI, the GUID of the same interface is the same."""
    names = ("second/Heater.fmu", "second/Heater_fmi3.fmu", "named/Heater.fmu")
    models = [fmpy.read_model_description(versions(name)) for name in names]
    second, third, named = (m.guid or m.instantiationToken for m in models)
    assert second == third
    assert named != second
