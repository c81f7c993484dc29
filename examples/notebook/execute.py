"""Execute the notebook of this folder in a fresh kernel and store it with its outputs.

    target/venv/bin/python examples/notebook/execute.py

The stored notebook depends only on the cells: it has no times, versions or machine names.
"""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parent / "pendulum.ipynb"


def execute(notebook: nbformat.NotebookNode, folder: Path = NOTEBOOK.parent) -> None:
    """Execute the cells of `notebook` in `folder`; raise CellExecutionError if one fails."""
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=60, record_timing=False, resources=resources).execute()
    notebook.metadata = nbformat.from_dict(
        {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        }
    )
    for number, cell in enumerate(notebook.cells, start=1):
        cell.id = f"cell-{number}"
        cell.metadata = nbformat.from_dict({})


if __name__ == "__main__":
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    execute(notebook)
    nbformat.write(notebook, NOTEBOOK)
