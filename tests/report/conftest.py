"""Folders and records of a small synthetic run, by attack; figures that are kept."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from run_samples import edit, write_run

from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures import facets
from mast_zenoh.show.figures.style import Figure


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a run that is only copied."""
    folder = tmp_path_factory.mktemp("runs")
    return cache(lambda attack: write_run(folder / (attack or "baseline"), attack))


@pytest.fixture
def run_folder(template: Callable[[str], Path], tmp_path: Path) -> Callable[..., Path]:
    """Writes a run with changed JSON files; attack: "", uncoordinated or coordinated."""

    def write(attack: str = "", **changes: Any) -> Path:
        folder = tmp_path / (attack or "baseline")
        while folder.exists():
            folder = folder.with_name(f"{folder.name}_again")
        return edit(Path(shutil.copytree(template(attack), folder)), **changes)

    return write


@pytest.fixture
def run_of(run_folder: Callable[..., Path]) -> Callable[..., Run]:
    """The record of such a run."""
    return lambda *args, **changes: Run(run_folder(*args, **changes))


@pytest.fixture
def three_runs(run_folder: Callable[..., Path]) -> dict[str, Path]:
    """The folders of the three runs of the case study by label."""
    return {attack or "baseline": run_folder(attack) for attack in ("", "uncoordinated", "coordinated")}


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn from now on."""
    figures: list[Figure] = []

    class Kept(Figure):
        def __init__(self, *arguments: object, **options: object) -> None:
            super().__init__(*arguments, **options)  # type: ignore[arg-type]
            figures.append(self)

    monkeypatch.setattr(facets, "Figure", Kept)
    return figures
