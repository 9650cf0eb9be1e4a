"""Liars that know the defence gain nothing by it: no honest agent is suspended, and they do less harm than without.

Runs and shares were chosen after these runs had been seen: they guard against a relapse, and are no evidence beyond.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import informed_liars
import pytest
from informed_liars import Balloon, BlindSwarm, Deadlock, Excuser, WallHugger, Wedge, Zombie

import mast_zenoh as mast
from mast_zenoh.attacks.adaptive import AdaptiveAttack
from mast_zenoh.testing import check_attack

FRAMES, START_S = 150, 3.0
#: (junction, seed) of the runs.
RUNS = ((8, 2000), (9, 2001))
#: Runs in which many objects leave a lone liar's view.
MANY_GONE = ((8, 2001), (9, 2000))


class Outcome(NamedTuple):
    """missed, false: objects a frame of the picture near the ego;  suspended, liars: names of agents"""

    missed: float
    false: float
    suspended: frozenset[str]
    liars: frozenset[str]


@cache
def played(attack: type[AdaptiveAttack] | None, liars: int, defence: str, run: tuple[int, int], **more: Any) -> Outcome:
    """One run of `defence_cell` with liars among its five agents; attack None: without any."""
    junction, seed = run
    kind = dict(type=f"{informed_liars.__file__}:{attack.__name__}", **more) if attack else "uncoordinated"
    # Undefended is without the input limit, too, which alone takes away half of a swarm.
    limit = {"broker.input_limit": dict(type="NoInputLimit")} if defence == "NoIntegrity" else {}
    with TemporaryDirectory() as folder:
        metrics = mast.run(
            "defence_cell",
            frames=FRAMES,
            seed=seed,
            out=Path(folder) / "run",
            record=False,
            scene="intersection",
            scene_index=junction,
            defence=defence,
            attack=kind,
            attack_start_s=START_S,
            n_adversaries=liars,
            placement="random",
            placement_seed=seed,
            placement_frames=FRAMES,
            **limit,
        ).summary
    picture = metrics["agents"]["ego"]["picture"]
    agents = metrics.get("integrity", {}).get("agents", {})
    return Outcome(
        picture["fn"]["mean"],
        picture["fp"]["mean"],
        frozenset(name for name, agent in agents.items() if agent["suspensions"]),
        frozenset(name for name, agent in agents.items() if agent["lied"]),
    )


def harm(attack: type[AdaptiveAttack], liars: int, defence: str, run: tuple[int, int], **more: Any) -> float:
    """Missed and false objects a frame, over those of the same run with the same defence and without liars."""
    attacked, honest = played(attack, liars, defence, run, **more), played(None, 0, defence, run)
    return attacked.missed + attacked.false - honest.missed - honest.false


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
