"""A synthetic matrix of published methods: as many defences, attacks and kinds of scene as are asked for."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from defence_samples import ATTACKED, matrix, summary
from defence_samples import row as defence_row

from mast_zenoh.metrics.study_results import BINOMIAL, BOOTSTRAP, STUDENT, Row, Statistic
from mast_zenoh.study.defences.matrix_table import MatrixTable, Published

SCENES = ("4 poles", "4 cars")
IDLE = Statistic(0.0, 0.0, 0.1, 30, 0, BINOMIAL)


def _attacked(attack: str, idle: bool) -> Statistic:
    return IDLE if idle else ATTACKED if attack else Statistic()


def field(
    defences: Sequence[str] = ("Wall", "Fence"),
    attacks: Sequence[str] = ("Ghost", "Flood"),
    scenes: Sequence[str] = SCENES,
    counts: Sequence[int] = (2,),
    idle: bool = False,
) -> MatrixTable:
    """The first defence helps against the first attack, in the first scene most; the last one does harm.

    idle: whether the first attack never takes place against the first defence
    """
    rng = np.random.default_rng(1)
    every = ("NoIntegrity", *defences)
    places = [("", 0, ""), *((attack, count, "random") for attack in attacks for count in counts)]
    rows = []
    for scene in ("", *scenes):
        for at, defence in enumerate(every):
            for attack, count, placement in places:
                harm = 0.0 if not at else float(rng.normal(-1.0 if attack else 0.0, 2.0))
                if attack == "Flood" and at:
                    harm = -26.4
                if (scene, at, attack) == (scenes[0], 1, attacks[0]):
                    harm = -2.5
                width = 0.4 if at % 2 else 9.0
                numbers = dict(
                    damage=Statistic(9.0 * bool(attack) + harm, 8.0, 10.0, 30, 0, STUDENT, 1e-9),
                    by_attack=Statistic(9.0 * bool(attack), 8.0, 10.0, 30, 0, STUDENT, 1e-9),
                    harm=Statistic(harm, harm - width, harm + width, 30, 0, BOOTSTRAP),
                    attacked=_attacked(attack, idle and (at, attack) == (1, attacks[0])),
                    honest_suspended=Statistic((0.0, 0.0, 0.1, 0.8)[at % 4], 0.0, 1.0, 30, 0, BINOMIAL),
                    cpu_ms=Statistic(4.0 + at, 3.9, 4.1, 30, 0, BOOTSTRAP),
                    cpu_ratio=Statistic(1.0 + at / 4.0, 1.0, 1.5, 30, 0, BOOTSTRAP),
                )
                of = dict(scene=scene, defence=defence, attack=attack, n_adversaries=count, placement=placement)
                rows.append(Row(of, 30, numbers))
    breakdowns = [
        Row(
            {
                "scene": scene,
                "defence": defence,
                "agents": 5 if scene else 0,
                "weakest": "Ghost" if defence == "Wall" else "",
            },
            30,
            {
                "broken 0": Statistic(0.0, 0.0, 0.1, 30),
                "broken 1": Statistic(0.2, 0.1, 0.3, 30),
                "broken 2": Statistic(0.8, 0.6, 0.9, 30),
                "breaks_at": Statistic(1.25, 1.1, 1.5, 30)
                if defence == "Wall"
                else Statistic(math.inf, 1.8, math.inf, 30),
                "weakest_at": Statistic(1.25 if defence == "Wall" else math.inf),
            },
        )
        for scene in ("", *scenes)
        for defence in every
    ]
    added = dict(
        harm_removed=Statistic(0.75, 0.6, 0.9, 30, 0, BOOTSTRAP),
        cpu_ratio_alone=Statistic(1.5, 1.4, 1.6, 30, 0, BOOTSTRAP),
        cpu_ratio_attacked=Statistic(1.2, 1.1, 1.3, 30, 0, BOOTSTRAP),
    )
    wall = Published(
        method="Wall",
        source="Wall & Brick, Journal of Walls 2025",
        figure="91.5 % of the ghosts",
        basis="abstract only, not checked",
        quantities=("lies_detected",),
        why="Walls are not tracks.",
    )
    published = [
        (wall, [Row({"defence": "Wall", "attack": "Ghost"}, 30, {"lies_detected": Statistic(0.5, 0.4, 0.6, 30)})])
    ]
    return replace(
        matrix(),
        rows=[
            replace(row, of=row.of | {"n_adversaries": count, "placement": placement})
            for name in every
            for attack, count, placement in places
            for row in [defence_row(name, attack)]
        ],
        summaries=[summary(name, **added) for name in defences],
        rocs={},
        delays={},
        scenes=list(scenes),
        by_scene=rows,
        breakdowns=breakdowns,
        published=published,
    )
