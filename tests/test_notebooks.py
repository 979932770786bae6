"""The notebooks of docs/notebooks run from the beginning to the end, and show pictures; they are kept without outputs."""

import json
import re
import shutil
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))
PICTURES = {"firmware": 1, "register_tuning": 1, "tour": 4}
"""How many pictures each shows at least."""
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_exactly_three_notebooks_exist():
    assert {path.stem for path in NOTEBOOKS} == PICTURES.keys()


@each
def test_a_notebook_has_no_stored_outputs_and_each_cell_has_its_id(path):
    notebook = json.loads(path.read_text())
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(code) > 3
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])


@pytest.mark.slow
@each
def test_a_notebook_runs_and_shows_its_pictures(path, tmp_path):
    client = pytest.importorskip("nbclient", reason="no nbclient: pip install -e '.[notebook]'")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    if path.stem == "firmware" and not shutil.which("cc"):
        pytest.skip("no C compiler: cc is not on the PATH")
    if path.stem == "register_tuning":
        pytest.importorskip("optuna")
    pytest.importorskip("pandas")
    notebook = nbformat.read(path, as_version=4)
    client.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [data for cell in notebook.cells for output in cell.get("outputs", []) if (data := output.get("data"))]
    pictures = [
        d for d in outputs if "image/png" in d or re.search(r'src="data:image/png;base64,', d.get("text/html", ""))
    ]
    assert len(pictures) >= PICTURES[path.stem]
    assert path.stem != "firmware" or "R2 is 13 bits wide" in str(notebook.cells[-1].outputs), "the mistake is told"
    assert not any(output.get("name") == "stderr" for cell in notebook.cells for output in cell.get("outputs", []))
