"""Liars that know the defence gain nothing by it: no honest agent is suspended, and they do less harm than without.

Runs and shares were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from __future__ import annotations

from typing import Any

import pytest
from informed_liars import Balloon, BlindSwarm, Deadlock, Excuser, WallHugger, Wedge, Zombie
from liar_runs import RUNS, harm, played

from mast_zenoh.attacks.adaptive import AdaptiveAttack
from mast_zenoh.testing import check_attack

#: Runs in which many objects leave a lone liar's view.
MANY_GONE = ((8, 2001), (9, 2000))


@pytest.mark.parametrize("attack", [Balloon, BlindSwarm, Deadlock, Excuser, WallHugger, Wedge, Zombie])
def test_informed_liars_are_what_an_attack_has_to_be(attack: type[AdaptiveAttack]) -> None:
    check_attack(attack(start_s=0.5))


@pytest.mark.heavy
@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize(
    ("attack", "more"),
    [
        (Balloon, {}),
        (Balloon, dict(deny=False)),
        (Deadlock, {}),
        (Wedge, {}),
        (Wedge, dict(shift_m=2.5)),
        (Excuser, {}),
    ],
)
def test_two_liars_of_five_suspend_no_honest_agent_and_do_no_more_harm_than_without_the_defence(
    attack: type[AdaptiveAttack], more: dict[str, Any], run: tuple[int, int]
) -> None:
    defended = played(attack, 2, "FaultOrLie", run, **more)
    assert len(defended.liars) == 2
    assert defended.suspended <= defended.liars
    assert harm(attack, 2, "FaultOrLie", run, **more) <= 1.1 * harm(attack, 2, "NoIntegrity", run, **more)


@pytest.mark.heavy
@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize(("attack", "share"), [(BlindSwarm, 0.5), (Excuser, 1 / 3), (WallHugger, 0.5)])
def test_a_lone_liar_does_at_most_half_of_its_harm_without_the_defence(
    attack: type[AdaptiveAttack], share: float, run: tuple[int, int]
) -> None:
    """An `Excuser` seems to have a fault, and is waited for: nearly a third of its harm is done then."""
    defended = played(attack, 1, "FaultOrLie", run)
    assert defended.suspended <= defended.liars
    assert harm(attack, 1, "FaultOrLie", run) <= share * harm(attack, 1, "NoIntegrity", run)


@pytest.mark.heavy
@pytest.mark.parametrize("run", MANY_GONE)
def test_a_lone_liar_goes_on_with_real_objects_where_nobody_else_looks(run: tuple[int, int]) -> None:
    """The exception: others confirmed what a `Zombie` reports, and do not look there now. Its harm is not halved."""
    defended = played(Zombie, 1, "FaultOrLie", run)
    assert defended.suspended <= defended.liars
    assert harm(Zombie, 1, "FaultOrLie", run) <= 1.1 * harm(Zombie, 1, "NoIntegrity", run)
