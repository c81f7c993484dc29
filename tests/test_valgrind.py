"""A host in C uses every FMU; under valgrind, without a bad access or a leak.

The runs under valgrind take a minute and are left out unless `pytest -m valgrind` asks for them.
"""

import shutil
import subprocess
from pathlib import Path

import pytest
from slave import Fmu, Variable, each_model, unpack

SOURCE = Path(__file__).parent / "c" / "host.c"

SCENARIOS = [
    "life_cycle", "values", "fmu_state", "damaged_bytes", "bad_arguments", "two_instances", "reset",
    "trouble",
]  # fmt: skip

VALGRIND = [
    "valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full",
    "--errors-for-leak-kinds=definite,indirect",
]  # fmt: skip

each_scenario = pytest.mark.parametrize("scenario", SCENARIOS)


@pytest.fixture(scope="session")
def host(tmp_path_factory) -> Path:
    """Compile the host."""
    program = tmp_path_factory.mktemp("host") / "host"
    compiler = shutil.which("cc")
    assert compiler, "`cc` is not on the PATH: the host in C cannot be compiled"
    options = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror", "-g"]
    subprocess.run([compiler, *options, "-o", program, SOURCE, "-ldl", "-lm"], check=True)
    return program


def described(variable: Variable) -> str:
    """Return a variable as the host takes it; times stay as they are."""
    text = f"{variable.kind[0].lower()}{variable.reference}"
    if variable.settable(running=False) and variable.name != "ts":
        return f"{text}={variable.other_value()!r}"
    return text


def arguments(fmu: Fmu, scenario: str) -> list[str]:
    """Return the arguments of the host."""
    variables = [described(variable) for variable in fmu.variables.values()]
    return [str(fmu.binary), fmu.guid.decode(), scenario, *variables]


def run(command: list) -> None:
    """Run a program that ends well and writes nothing."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@each_model
@each_scenario
def test_a_host_in_c_is_served(fmus, host, model, scenario):
    run([host, *arguments(unpack(fmus, model), scenario)])


@pytest.mark.valgrind
@each_model
@each_scenario
def test_valgrind_finds_nothing(fmus, host, model, scenario):
    if shutil.which("valgrind") is None:
        pytest.fail("`valgrind` is not on the PATH: `make valgrind` installs it", pytrace=False)
    run([*VALGRIND, host, *arguments(unpack(fmus, model), scenario)])
