"""Errors are attributed to an attack, a fault or a defence only if they do not exist in the run without it."""

from functools import cache
from typing import Any

import pytest
import wrong_blame

pytestmark = pytest.mark.heavy


@cache
def table(number: int, side: str, scene: str, dense: bool) -> Any:
    """The objects of a run, played once; number: of a cell, side: "first" or "twin"."""
    junction = dict(type="Intersection", scene_index=int(scene.partition(":")[2]), dense=dense)
    place = wrong_blame.Where(junction, seed=3, frames=130)
    return wrong_blame.objects(getattr(wrong_blame.cells()[number], side), place)


def shares(name: str, lacks: str, outcome: str, scene: str, dense: bool = True) -> tuple[float, float, int]:
    """Of the errors that exist without the cause, and of the others, the shares blamed on it; the number of others."""
    number = next(k for k, cell in enumerate(wrong_blame.cells()) if (cell.name, cell.lacks) == (name, lacks))
    one, other = (wrong_blame.errors(table(number, side, scene, dense), outcome) for side in ("first", "twin"))
    pairs = zip(wrong_blame.in_twin(one, other, outcome).tolist(), one["cause"], strict=True)
    blamed: dict[bool, list[bool]] = {True: [], False: []}
    for present, cause in pairs:
        blamed[present].append(cause in wrong_blame.BLAMED[lacks])
    wrong, right = (sum(blamed[present]) / max(len(blamed[present]), 1) for present in (True, False))
    return wrong, right, len(blamed[False])


def test_objects_that_the_defence_withholds_are_missed_because_of_it() -> None:
    wrong, right, new = shares("no attack, KOfN", "defence", "missed", "intersection:5")
    assert new > 20
    assert right > 0.95
    assert wrong < 0.01


def test_false_tracks_that_exist_without_the_attack_are_not_attributed_to_it() -> None:
    wrong, right, new = shares("uncoordinated", "attack", "false", "intersection:5")
    assert new > 1000
    assert right > 0.97
    assert wrong < 0.1


def test_false_tracks_due_to_a_wrong_clock_are_attributed_to_the_fault() -> None:
    wrong, right, new = shares("skew .4 s", "fault", "false", "intersection:5")
    assert new > 100
    assert right > 0.94
    assert wrong < 0.05


@pytest.mark.parametrize(("dense", "most"), [(False, 0.06), (True, 0.12)])  # of a crowd, more is missed anyway
def test_a_blind_sector_is_blamed_for_what_it_hides_alone(dense: bool, most: float) -> None:
    wrong, right, new = shares("blind", "fault", "missed", "intersection:5", dense)
    assert new > 100
    assert right > 0.9
    assert wrong < most
