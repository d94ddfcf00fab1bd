"""The notebooks of examples/, executed as a reader would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.site]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


def read(path: Path) -> Any:
    """The notebook. Only `.ci/long site` installs what reads it."""
    import nbformat

    return nbformat.read(path, 4)


def code(book: Any) -> list[str]:
    """Lines of code, without blank ones."""
    cells = (cell.source for cell in book.cells if cell.cell_type == "code")
    return [line for text in cells for line in text.splitlines() if line.strip()]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_and_leaves_nothing_behind(path: Path) -> None:
    import nbclient

    book = read(path)
    assert not any(cell.get("outputs") for cell in book.cells), "outputs belong to readers"
    before = set(EXAMPLES.iterdir())
    resources = {"metadata": {"path": str(EXAMPLES)}}
    nbclient.NotebookClient(book, timeout=120, kernel_name="python3", resources=resources).execute()
    outputs = [o for cell in book.cells if cell.cell_type == "code" for o in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    warned = [output.text for output in outputs if output.get("name") == "stderr"]
    assert warned == []
    assert set(EXAMPLES.iterdir()) == before


def test_a_sweep_is_plotted_in_ten_lines() -> None:
    assert len(code(read(EXAMPLES / "sweep.ipynb"))) == 10
