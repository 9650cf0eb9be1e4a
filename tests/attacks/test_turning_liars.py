"""Liars that turn a rule of the defence against honest agents do little harm and suspend nobody.

Runs and limits were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from __future__ import annotations

import pytest
from liar_runs import harm, played
from turning_liars import Giant, Pulse, Tailgate

from mast_zenoh.attacks.adaptive import AdaptiveAttack
from mast_zenoh.testing import check_attack

RUN = (300, 2300)
#: Objects a frame; harm below is chance.
SLIGHT = 0.3


@pytest.mark.parametrize("attack", [Giant, Pulse, Tailgate])
def test_turning_liars_are_what_an_attack_has_to_be(attack: type[AdaptiveAttack]) -> None:
    check_attack(attack(start_s=0.5))


@pytest.mark.heavy
@pytest.mark.parametrize(("attack", "liars"), [(Giant, 1), (Pulse, 2), (Tailgate, 2)])
def test_liars_that_turn_a_rule_of_the_defence_gain_nothing_by_it(attack: type[AdaptiveAttack], liars: int) -> None:
    defended = played(attack, liars, "FaultOrLie", RUN)
    assert len(defended.liars) == liars
    assert defended.suspended <= defended.liars
    undefended = harm(attack, liars, "NoIntegrity", RUN)
    assert harm(attack, liars, "FaultOrLie", RUN) <= max(0.5 * undefended, SLIGHT)
