"""Liars that know the defence gain nothing by it: no honest agent is suspended, and they do less harm than without.

Runs and shares were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from typing import Any

import pytest
from agreeing_liars import BesideReal, FrameTwo, Scapegoats, Turned
from informed_liars import Balloon, BlindSwarm, Deadlock, Excuser, WallHugger, Wedge, Zombie
from liar_runs import RUNS, harm, played
from turning_liars import Giant, Pulse, Tailgate

pytestmark = pytest.mark.heavy

#: Runs in which many objects leave a lone liar's view.
MANY_GONE = ((8, 2001), (9, 2000))
TURNED = ((300, 2300),)
#: Liar, its settings, number of liars, runs, greatest share of the harm without the defence that it may do, and harm in
#: objects a frame that is chance. An `Excuser` seems to have a fault, and is waited for: nearly a third of its harm is
#: done then. Others confirmed what a `Zombie` reports, and do not look there now: its harm is not halved.
LIARS: list[tuple[type, dict[str, Any], int, tuple, float, float]] = [
    *((liar, {}, 2, RUNS, 1.1, 0.0) for liar in (Balloon, Deadlock, Wedge, Excuser)),
    (Balloon, dict(deny=False), 2, RUNS, 1.1, 0.0),
    (Wedge, dict(shift_m=2.5), 2, RUNS, 1.1, 0.0),
    (BlindSwarm, {}, 1, RUNS, 0.5, 0.0),
    (Excuser, {}, 1, RUNS, 1 / 3, 0.0),
    (WallHugger, {}, 1, RUNS, 0.5, 0.0),
    (Zombie, {}, 1, MANY_GONE, 1.1, 0.0),
    (BesideReal, {}, 1, RUNS[:1], 0.5, 0.0),
    (Scapegoats, {}, 2, RUNS[:1], 0.5, 0.0),
    *((liar, {}, 2, RUNS[:1], 1.1, 0.1) for liar in (FrameTwo, Turned)),
    (Giant, {}, 1, TURNED, 0.5, 0.3),
    *((liar, {}, 2, TURNED, 0.5, 0.3) for liar in (Pulse, Tailgate)),
]
#: Of the runs of a liar the first and the last in turn.
CASES = [(case[3][-(number % 2)], *case) for number, case in enumerate(LIARS)]


@pytest.mark.parametrize(("run", "attack", "more", "liars", "runs", "share", "chance"), CASES)
def test_liars_suspend_no_honest_agent_and_do_no_more_harm_than_a_share(run, attack, more, liars, runs, share, chance):
    defended = played(attack, liars, "FaultOrLie", run, **more)
    assert len(defended.liars) == liars
    assert defended.suspended <= defended.liars
    undefended = harm(attack, liars, "NoIntegrity", run, **more)
    assert harm(attack, liars, "FaultOrLie", run, **more) <= max(share * undefended, chance)
