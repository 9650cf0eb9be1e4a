"""Liars that know the defence gain nothing by it: no honest agent is suspended, and they do less harm than without.

Runs and limits were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from typing import Any

import pytest
from agreeing_liars import BesideReal, FrameTwo, Scapegoats, Turned
from informed_liars import Balloon, BlindSwarm, Deadlock, Excuser, WallHugger, Wedge, Zombie
from liar_runs import harm, played
from turning_liars import Giant, Pulse, Tailgate

pytestmark = [pytest.mark.heavy, pytest.mark.long]

#: Liar, its settings, number of liars, junction and seed of the run, and the harm that they may do, in objects a frame.
#: That is half of what they do without a defence and an input limit, or 0.3, which is chance. Where two agree it is as
#: much as without and a tenth more; so it is for a `Zombie`, as others confirmed what it reports, and do not look there
#: now. An `Excuser` seems to have a fault, and is waited for: a third of its harm is done then.
LIARS: list[tuple[type, dict[str, Any], int, int, int, float]] = [
    (Balloon, {}, 2, 8, 2000, 14.1),
    (Balloon, dict(deny=False), 2, 8, 2000, 14.1),
    (Deadlock, {}, 2, 9, 2003, 9.1),
    (Wedge, {}, 2, 8, 2000, 1.3),
    (Wedge, dict(shift_m=2.5), 2, 9, 2003, 12.3),
    (Excuser, {}, 2, 9, 2003, 15.1),
    (Excuser, {}, 1, 9, 2003, 2.7),
    (BlindSwarm, {}, 1, 8, 2000, 7.9),
    (WallHugger, {}, 1, 8, 2000, 8.0),
    (Zombie, {}, 1, 9, 2000, 2.7),  # many objects leave its view
    (BesideReal, {}, 1, 8, 2000, 11.3),
    (Scapegoats, {}, 2, 8, 2000, 10.1),
    (FrameTwo, {}, 2, 8, 2000, 1.7),
    (Turned, {}, 2, 8, 2000, 0.12),
    (Giant, {}, 1, 300, 2300, 0.3),
    (Pulse, {}, 2, 300, 2300, 0.3),
    (Tailgate, {}, 2, 300, 2300, 13.6),
]


@pytest.mark.parametrize(("attack", "more", "liars", "junction", "seed", "most"), LIARS)
def test_liars_suspend_no_honest_agent_and_do_little_harm(attack, more, liars, junction, seed, most) -> None:
    defended = played(attack, liars, junction, seed, **more)
    assert len(defended.liars) == liars
    assert defended.suspended <= defended.liars
    assert harm(defended, junction, seed) <= most
