"""docs/scene_arrays.md works as written."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mast_zenoh as mast

PAGE = (Path(__file__).parents[2] / "docs" / "scene_arrays.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.S | re.M)


def test_every_block_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in BLOCKS:
        exec(compile(block, "scene_arrays.md", "exec"), names)
    metrics = names["run"].summary["agents"]["ego"]["picture"]
    assert metrics["tp"]["mean"] > 20
    assert names["run"].agents == ("ego", "mobile_1", "mobile_2")
    assert names["scene"].agents == ("ego", "infra_1", "infra_2")


def test_the_highway_takes_ten_lines() -> None:
    assert len([line for line in BLOCKS[0].splitlines() if line.strip()]) <= 10


def test_the_page_names_every_array_of_the_file(tmp_path: Path) -> None:
    mast.scene(times_s=[0.0, 0.1], position=np.zeros((2, 1, 2))).save(tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as file:
        named = set(re.findall(r"`([\w.]+)`", PAGE[PAGE.index("## The file") :]))
        prefixed = {f"{group}.{name[1:]}" for group in ("truth", "detections") for name in named if name[0] == "."}
        assert set(file.files) <= named | prefixed
