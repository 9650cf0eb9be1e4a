"""Liars that agree without talking to each other, or alter what is real, gain nothing by it.

Runs and shares were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from __future__ import annotations

import pytest
from agreeing_liars import (
    AgainstEgo,
    AtBumper,
    BesideReal,
    FrameTwo,
    Growing,
    HeadingDrift,
    OnOff,
    OnOffHalf,
    Scapegoats,
    Turned,
)
from liar_runs import RUNS, harm, played

from mast_zenoh.attacks.adaptive import AdaptiveAttack
from mast_zenoh.testing import check_attack

#: Liars about positions, headings, velocities and sizes of real objects.
ALTERING: list[type[AdaptiveAttack]] = [AgainstEgo, FrameTwo, Growing, HeadingDrift, OnOff, OnOffHalf, Turned]
#: Objects a frame; harm below is chance: most of these liars change few positions by as much as a false object takes.
SLIGHT = 0.1


@pytest.mark.parametrize("attack", [AtBumper, BesideReal, Scapegoats, *ALTERING])
def test_agreeing_liars_are_what_an_attack_has_to_be(attack: type[AdaptiveAttack]) -> None:
    check_attack(attack(start_s=0.5))


@pytest.mark.heavy
@pytest.mark.parametrize(("attack", "liars"), [(BesideReal, 1), (Scapegoats, 2)])
def test_liars_about_ghosts_do_at_most_half_of_their_harm_without_the_defence(
    attack: type[AdaptiveAttack], liars: int
) -> None:
    defended = played(attack, liars, "FaultOrLie", RUNS[0])
    assert len(defended.liars) == liars
    assert defended.suspended <= defended.liars
    assert harm(attack, liars, "FaultOrLie", RUNS[0]) <= 0.5 * harm(attack, liars, "NoIntegrity", RUNS[0])


@pytest.mark.heavy
@pytest.mark.parametrize("attack", [FrameTwo, Turned])
def test_two_liars_about_real_objects_suspend_no_honest_agent_and_do_no_more_harm_than_without_the_defence(
    attack: type[AdaptiveAttack],
) -> None:
    defended = played(attack, 2, "FaultOrLie", RUNS[0])
    assert len(defended.liars) == 2
    assert defended.suspended <= defended.liars
    undefended = harm(attack, 2, "NoIntegrity", RUNS[0])
    assert harm(attack, 2, "FaultOrLie", RUNS[0]) <= max(1.1 * undefended, SLIGHT)
