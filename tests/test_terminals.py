"""Connections between terminals, which connect their members."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from native import LOOPS, refusal, replaced, simulate
from pendulum_fmus.project import FMUS

MEMBERS = ["source.r -> controller.r", "source.d -> controller.d"]
MEMBERS += ["plant.theta -> controller.y", "controller.u -> plant.u"]


@pytest.fixture(scope="module", autouse=True)
def _fmus(fmus: Path) -> None:
    pass


def loop(folder: Path, connections: Sequence[str]) -> Path:
    """Write the loop of the PID with FMUs of FMI 3.0, 1 s long, connected in this way."""
    text = replaced((LOOPS / "pid.toml").read_text(), {"../../target/fmu/": f"{FMUS}/"})
    head, tail = text.split("connections = [", 1)
    text = f"{head}connections = {list(connections)}{tail.split(']', 1)[1]}"
    file = folder / "loop.toml"
    file.write_text(replaced(text, {".fmu": "_fmi3.fmu", "stop = 20.0": "stop = 1.0"}))
    return file


def test_terminals_connect_all_their_members(tmp_path: Path) -> None:
    # The order does not matter.
    terminals = ["controller.reference -> source.reference", "plant.loop -> controller.loop"]
    alone, together = (
        simulate(loop(tmp_path, connections), tmp_path) for connections in (MEMBERS, terminals)
    )
    assert alone.keys() == together.keys()
    for name, values in alone.items():
        np.testing.assert_array_equal(values, together[name])


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        (
            "plant.loop -> controller.reference",
            "plant.loop -> controller.reference: the other terminal has no u",
        ),
        ("plant.loop -> controller.y", "plant.loop is a terminal, but controller.y is none"),
        (
            "plant.theta -> controller.loop",
            "controller.loop is a terminal, but plant.theta is none",
        ),
    ],
)
def test_what_does_not_match_is_refused(tmp_path: Path, connection: str, message: str) -> None:
    assert message in refusal(tmp_path, "simulate", loop(tmp_path, [connection]))


def test_terminals_with_a_conversion_are_refused(tmp_path: Path) -> None:
    file = loop(tmp_path, ["plant.loop -> controller.loop"])
    text = file.read_text()
    converted = '{ from = "plant.loop", to = "controller.loop", factor = 2.0 }'
    file.write_text(replaced(text, {"'plant.loop -> controller.loop'": converted}))
    assert "connects terminals, expected neither a conversion nor faults" in refusal(
        tmp_path, "simulate", file
    )
