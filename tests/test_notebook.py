"""The notebook runs, its gain is correct, and its stored outputs are current."""

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

angle, force = (steps["LQR"][name].tolist() for name in ("plant.theta", "controller.u"))
print(json.dumps([K.tolist(), angle, force]))
"""
"""A cell that prints the exact numbers."""

STORED = nbformat.read(NOTEBOOK, as_version=4)


@pytest.fixture(scope="module")
def executed(fmus: Path) -> tuple[NotebookNode, list[list[float]]]:
    """Execute the notebook; return it, and the gain of the LQR with its angles and forces."""
    notebook = copy.deepcopy(STORED)
    notebook.cells.append(new_code_cell(PROBE))
    execute(notebook, NOTEBOOK.parent)
    return notebook, json.loads(notebook.cells.pop().outputs[0].text)


def texts(notebook: NotebookNode) -> list[str]:
    """Return the output of the cells, platform-independent, with placeholders for plots."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = [output.get("text") or output.data["text/plain"] for output in outputs]
    return [re.sub(r"^binaries/.*\n", "", text, flags=re.MULTILINE) for text in printed]


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
    phi = expm(augmented * reference.TS)
    return phi[:3, :3], phi[:3, 3:]


def test_the_gain_is_the_lqr_gain_and_reaches_the_set_point(executed) -> None:
    A, B = feedback_model()
    Q, R = np.diag([1e6, 1e5, 1e3]), np.eye(1)
    P = solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    gain, angle, force = executed[1]
    np.testing.assert_allclose(gain, K, rtol=1e-6)
    assert max(map(abs, force)) <= 100
    assert angle[-1] == pytest.approx(1.0, abs=1e-6)
