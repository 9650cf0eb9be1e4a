"""Short runs with liars among five agents, and the harm that they do."""

from functools import cache
from inspect import getfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import mast_zenoh as mast
from mast_zenoh.attacks.adaptive import AdaptiveAttack

FRAMES, START_S = 150, 3.0
#: (junction, seed) of the runs.
RUNS = ((8, 2000), (9, 2003))


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
    kind = dict(type=f"{getfile(attack)}:{attack.__name__}", **more) if attack else "uncoordinated"
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
