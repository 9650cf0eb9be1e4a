"""Simulated coverage of 95 % intervals, as documented in docs/studies.md."""

from __future__ import annotations

from pathlib import Path

import interval_coverage
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "studies.md"

Coverage = dict[str, dict[tuple[int, int], float]]


@pytest.fixture(scope="module")
def simulated() -> Coverage:
    return interval_coverage.table()


@pytest.mark.parametrize("world", list(interval_coverage.worlds()), ids=lambda world: world.name)
def test_claimed_intervals_cover_93_to_97_per_cent(simulated: Coverage, world: interval_coverage.World) -> None:
    claimed = {
        cell: percent
        for cell, percent in simulated[world.name].items()
        if world.claimed is not None and cell[1] >= world.claimed
    }
    assert all(93.0 <= percent <= 97.0 for percent in claimed.values()), claimed


def test_intervals_of_success_rates_cover_at_least_95_per_cent(simulated: Coverage) -> None:
    rates = {name: cells for name, cells in simulated.items() if name.startswith("success rate")}
    assert len(rates) == 6
    assert min(min(cells.values()) for cells in rates.values()) >= 95.0


def test_intervals_of_added_missed_objects_cover_at_least_93_per_cent_with_any_number_of_seeds(
    simulated: Coverage,
) -> None:
    """A t interval for every mean covers 78 % with five seeds."""
    for attack in ("uncoordinated-2", "coordinated-2"):
        assert min(simulated[f"missed objects added, {attack}"].values()) >= 93.0
    assert simulated["missed objects added, uncoordinated-2, t for every mean"][1, 5] < 80.0


def test_three_correlated_scenes_of_twenty_seeds_are_covered(simulated: Coverage) -> None:
    """A bootstrap that treats scenes and seeds as independent covers 71 % here."""
    assert 93.0 <= simulated["normal, scenes of a seed correlate at 0.98"][3, 20] <= 97.0


def test_page_shows_the_simulated_coverage(simulated: Coverage) -> None:
    """Within 0.3, as another NumPy version may draw other samples."""
    lines = [line.strip("| \n").split(" | ") for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| ")]
    documented = {line[0].strip(): [cell.strip(" |") for cell in line[1:]] for line in lines}
    for line in interval_coverage.as_markdown(simulated).splitlines()[2:]:
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        assert name in documented, name
        values = [float(cell) for cell in documented[name] if cell]
        assert values == pytest.approx([float(cell) for cell in cells if cell], abs=0.3), name
