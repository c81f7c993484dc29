"""The notebook runs, its numbers are correct, and its stored outputs are current."""

import copy
import json
import re
import runpy
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell
from scipy.linalg import expm, solve_discrete_are

import reference
from pendulum_fmus.project import ROOT

SCRIPT = runpy.run_path(str(ROOT / "examples" / "notebook" / "execute.py"))
NOTEBOOK, execute = SCRIPT["NOTEBOOK"], SCRIPT["execute"]

PROBE = """
import json

runs = {**steps, **gains}
columns = {name: {key: run[key].tolist() for key in run} for name, run in runs.items()}
print(json.dumps([K.tolist(), columns]))
"""
"""A cell that prints the exact numbers."""

TS = reference.TS
STEPS = 10000


STORED = nbformat.read(NOTEBOOK, as_version=4)


@pytest.fixture(scope="module")
def executed(fmus: Path) -> tuple[NotebookNode, np.ndarray, dict]:
    """Execute the notebook; return it, the gain of the LQR, and the columns of all runs."""
    notebook = copy.deepcopy(STORED)
    notebook.cells.append(new_code_cell(PROBE))
    execute(notebook, NOTEBOOK.parent)
    gain, runs = json.loads(notebook.cells.pop().outputs[0].text)
    return notebook, gain, {name: {k: np.array(run[k]) for k in run} for name, run in runs.items()}


def texts(notebook: NotebookNode) -> list[str]:
    """Return the output of the cells, platform-independent, with placeholders for plots."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = [output.get("text") or output.data["text/plain"] for output in outputs]
    return [re.sub(r"^binaries/.*\n", "", text, flags=re.MULTILINE) for text in printed]


def table(notebook: NotebookNode, header: str) -> dict[str, list[float]]:
    """Return the numbers of a printed table, by the beginning of the row."""
    (text,) = [text for text in texts(notebook) if text.startswith(header)]
    rows = [re.split(r"\s{2,}", line.strip()) for line in text.splitlines()[1:]]
    return {name: [float(cell.split()[0]) for cell in cells] for name, *cells in rows}


# --- stored outputs -----------------------------------------------------------------------------


def test_stored_notebook_is_valid_executed_and_small_and_has_no_machine_names() -> None:
    nbformat.validate(STORED)
    code = [cell for cell in STORED.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert NOTEBOOK.stat().st_size < 400_000
    text = "\n".join([cell.source for cell in STORED.cells] + texts(STORED))
    assert not re.search(r"/(home|root|tmp|Users|usr)/|[A-Z]:\\", text)
    assert not any(cell.metadata for cell in STORED.cells)
    assert STORED.metadata.language_info == {"name": "python"}


def test_stored_outputs_match_a_run(executed) -> None:
    notebook = executed[0]
    assert texts(STORED) == texts(notebook)
    assert sum("image/png" in output.get("data", {}) for cell in notebook.cells
               for output in cell.get("outputs", [])) == 4  # fmt: skip


# --- its numbers --------------------------------------------------------------------------------


def feedback_model() -> tuple[np.ndarray, np.ndarray]:
    """Return Ad (3, 3), Bd (3, 1) of (integral of theta, theta, omega) without friction."""
    A, B = reference.linear_model()
    A = A.copy()
    A[:, 1] += reference.b * B  # u = b v + w
    augmented = np.zeros((4, 4))
    augmented[0, 1] = 1
    augmented[1:3, 1:3], augmented[1:3, 3] = A[2:, 2:], B[2:]
    phi = expm(augmented * TS)
    return phi[:3, :3], phi[:3, 3:]


def test_gain_is_the_lqr_gain(executed) -> None:
    A, B = feedback_model()
    Q, R = np.diag([1e6, 1e5, 1e3]), np.eye(1)
    P = solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    np.testing.assert_allclose(executed[1], K, rtol=1e-6)


def test_own_controller_matches_numpy(executed) -> None:
    _, gain, runs = executed
    plant, integral, theta = reference.Plant(), 0.0, []
    for _ in range(STEPS):
        _, v, angle, omega = plant.state
        theta.append(angle)
        e = angle - 1.0
        u = reference.b * v - np.dot(gain, (integral, e, omega))
        integral += e * TS * (abs(u) < 100)
        plant.step(min(max(u, -100), 100), TS)
    run = runs["LQR"]
    np.testing.assert_allclose(run["plant.theta"], theta, rtol=0, atol=1e-9)
    assert np.max(np.abs(run["controller.u"])) <= 100
    assert run["plant.theta"][-1] == pytest.approx(1.0, abs=1e-6)


def test_printed_tables_follow_from_the_runs(executed) -> None:
    notebook, _, runs = executed
    printed = table(notebook, " " * 11 + "settling")
    assert list(printed) == ["PID", "PID-RBF", "IPID-RBF", "LQR"]
    for name, row in printed.items():
        run = runs[name]
        t, e = run["time"], 1 - run["plant.theta"]
        settled = t[max(k for k in range(STEPS) if abs(e[k]) > 0.003) + 1]
        integrals = [sum(x) * TS for x in (abs(e), e * e, t * abs(e))]
        expected = [settled, *integrals, max(run["plant.theta"]) - 1]
        assert row == pytest.approx(expected, abs=6e-4), name
    for name, row in table(notebook, "kp").items():
        theta = runs[name]["plant.theta"]
        assert row == pytest.approx([max(theta[:5000]) - 1, -min(theta) - 1], abs=6e-4), name
