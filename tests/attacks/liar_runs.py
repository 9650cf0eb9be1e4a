"""Short runs with liars among five agents, and the harm that they do."""

from functools import cache
from inspect import getfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import mast_zenoh as mast
from mast_zenoh.attacks.adaptive import AdaptiveAttack

FRAMES, START_S = 150, 3.0


class Outcome(NamedTuple):
    """missed, false: objects a frame of the picture near the ego;  suspended, liars: names of agents"""

    missed: float
    false: float
    suspended: frozenset[str]
    liars: frozenset[str]


@cache
def played(attack: type[AdaptiveAttack] | None, liars: int, junction: int, seed: int, **more: Any) -> Outcome:
    """One run of `defence_cell` with liars among its five agents; attack None: without any."""
    kind = dict(type=f"{getfile(attack)}:{attack.__name__}", **more) if attack else "uncoordinated"
    with TemporaryDirectory() as folder:
        metrics = mast.run(
            "defence_cell",
            frames=FRAMES,
            seed=seed,
            out=Path(folder) / "run",
            record=False,
            scene="intersection",
            scene_index=junction,
            defence="FaultOrLie",
            attack=kind,
            attack_start_s=START_S,
            n_adversaries=liars,
            placement="random",
            placement_seed=seed,
            placement_frames=FRAMES,
        ).summary
    picture = metrics["agents"]["ego"]["picture"]
    agents = metrics.get("integrity", {}).get("agents", {})
    return Outcome(
        picture["fn"]["mean"],
        picture["fp"]["mean"],
        frozenset(name for name, agent in agents.items() if agent["suspensions"]),
        frozenset(name for name, agent in agents.items() if agent["lied"]),
    )


def harm(attacked: Outcome, junction: int, seed: int) -> float:
    """Missed and false objects a frame, over those of the same run without liars."""
    honest = played(None, 0, junction, seed)
    return attacked.missed + attacked.false - honest.missed - honest.false
