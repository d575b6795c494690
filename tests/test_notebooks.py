"""The notebooks of the documentation run from the first cell to the last, and show something."""

from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SECONDS_A_CELL = 240


def outputs(notebook) -> list:
    return [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]


def test_notebooks_are_stored_without_output_and_named_on_their_page():
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) == 2
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        assert not outputs(notebook) and f"(notebooks/{path.name})" in page


@pytest.mark.long
@pytest.mark.filterwarnings("default")  # of the client, not of the notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs(path, tmp_path):
    """In a kernel of its own, from a folder as deep as the checkout's."""
    folder = tmp_path / "docs" / "notebooks"
    folder.mkdir(parents=True)
    (tmp_path / "data").symlink_to(ROOT / "data")
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=SECONDS_A_CELL, resources=place).execute()
    shown = outputs(notebook)
    assert not [o for o in shown if o.output_type == "error" or o.get("name") == "stderr"]
    data = [o.data for o in shown if "data" in o]
    assert not any("ipywidgets" in text for d in data for text in d.values() if text)
    assert any("image/png" in d for d in data)
    assert any("<table" in d.get("text/html", "") for d in data)
    assert (folder / "media-posterior" / "report.html").is_file()
    # The live line of a long call leaves nothing behind.
    assert not any(d.get("text/plain") == "writing" for d in data)
