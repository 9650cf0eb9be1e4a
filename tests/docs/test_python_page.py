"""docs/python.md and docs/notebook.ipynb work as written."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import mast_zenoh as mast

pytestmark = pytest.mark.heavy

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.timeout(300)
def test_every_block_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, flags=re.S | re.M)
    assert len(blocks) == len(re.findall(r"^```\w", page, flags=re.M)) >= 10, "a block that no test runs"
    names: dict[str, Any] = {"__name__": __name__}
    for block in blocks:
        exec(compile(block, "python.md", "exec"), names)
    assert (tmp_path / "birdseye.png").stat().st_size > 10_000
    assert names["mine"].attacks.num_rows > names["run"].attacks.num_rows
    assert names["study"].table().num_rows > 100


def test_the_page_names_every_table_column() -> None:
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    named = {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}
    shapes = {"frame", "time_s", "id", "class", "x", "y", "z", "vx", "vy", "vz", "l", "w", "h", "yaw"}
    assert shapes | {"score", "points", "support"} <= named


def cells() -> list[str]:
    notebook = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in code), "outputs are not kept, as they become outdated"
    return ["".join(cell["source"]) for cell in code]


def test_the_notebook_plots_false_positives_of_two_runs_in_fewer_than_15_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code = cells()
    assert sum(bool(line.strip()) for cell in code for line in cell.splitlines()) < 15
    names: dict[str, Any] = {}
    displayed = []
    for cell in code:  # like a notebook: display the value of the last line
        *body, last = cell.splitlines()
        exec("\n".join(body), names)
        displayed.append(eval(last, names))
    assert not list(tmp_path.iterdir()), "it writes into a temporary folder"
    run, over_time, birdseye, _ = displayed
    assert isinstance(run, mast.Run)
    assert isinstance(over_time, Figure)
    labels = {line.get_label() for line in over_time.axes[0].get_lines()}
    assert {"picture, baseline", "picture, uncoordinated"} <= labels
    assert "false objects" in over_time.axes[0].get_ylabel()
    for figure in (over_time, birdseye):
        assert figure._repr_png_()[:4] == b"\x89PNG"
