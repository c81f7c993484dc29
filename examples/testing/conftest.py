"""The option for the system under test, and one run of it."""

from pathlib import Path

import pytest

from fmu_master import Result, System

LOOP = Path(__file__).parents[1] / "closed-loop" / "pid.toml"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add an option for another system."""
    parser.addoption("--system", type=Path, default=LOOP, help="the system file under test")


@pytest.fixture(scope="session")
def system(request: pytest.FixtureRequest) -> System:
    """Return the system under test."""
    return System(request.config.getoption("--system"))


@pytest.fixture(scope="session")
def small_step(system: System) -> Result:
    """Return a run in which the set-point jumps by 0.1 mrad, too little to reach a limit."""
    return system.simulate(
        {"source.amplitude": 1e-4},
        stop_time=5.0,
        output=["source.r", "plant.theta", "controller.y", "controller.u", "plant.u"],
    )
