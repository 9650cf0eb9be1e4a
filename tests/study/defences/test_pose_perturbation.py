"""PosePert's closed loop beside ours: what is paired, which roads count, and what the tables say."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.study import definition
from mast_zenoh.study.defences.kinds import Factors
from mast_zenoh.study.defences.pose_perturbation import PUBLISHED, PosePerturbation, conclusion

SEEDS = 6


def factors_of(case: str, frames: int, defence: str = "") -> Factors:
    return Factors(case=case, frames=frames, step_m=0.5 if frames else 0.0, start_s=2.0, defence=defence)


def trial(label: str, seed: int, kmh: float, ttc_s: float | None, shift_m: float, alarm: bool, hits: int = 0) -> Any:
    """A trial of 60 frames; the shift is there from 2 s on, and 0.1 m before."""
    part = {
        "times_s": [0.1 * frame for frame in range(60)],
        "kmh": [25.0] * 40 + [kmh] * 20,
        "shift_m": [0.1] * 20 + [0.1 + shift_m + 0.01 * seed] * 39 + [None],
        "alarm": [False] * 20 + [alarm] * 40,
    }
    driven: dict[str, Any] = {"ego": {"collisions": [{}] * hits, "min_ttc_s": ttc_s}}
    return outcome(label, "road", seed, {"defence": part, "driven": driven})


def study_of(case: str, attacked: dict[int, tuple[float, float | None, int]], shift_m: float) -> PosePerturbation:
    """Twins, and trials of an attack with (least speed, least TTC, collisions) by seed; another one on the first road,
    whose twin is not safe."""
    cells = {"twin": factors_of(case, 0), "attack": factors_of(case, 5)}
    study = PosePerturbation(cells, ["road"], range(SEEDS))
    for seed in range(SEEDS):
        unsafe = seed == 0
        study.add(trial("twin", seed, 10.0 if unsafe else 24.0, 1.0 if unsafe else 3.0, 0.0, False))
        kmh, ttc_s, hits = attacked.get(seed, (24.0, 3.0, 0))
        study.add(trial("attack", seed, kmh, ttc_s, shift_m, True, hits))
    return study


def test_roads_count_whose_twin_is_safe_and_are_compared_with_it() -> None:
    (row,) = study_of("cut_in", {0: (0.0, None, 0), 1: (19.0, None, 0), 2: (21.0, 1.0, 0)}, -0.6).table()
    assert row.trials == SEEDS - 1
    assert row["slowed"].value == row["harm"].value == pytest.approx(1 / 5), "3 km/h are less than 4"
    assert row["slowed"].low < 0.2 < row["slowed"].high
    assert row["shift_m"].value == pytest.approx(0.6), "toward the lane, from the twin's"
    assert row["alarms"].value > 0.9
    assert row["false_alarms"].value == 0.0


def test_a_suppressed_leader_is_unsafe_if_hit_or_nearly() -> None:
    study = study_of("leader", {1: (24.0, 1.4, 0), 2: (24.0, 2.0, 1), 3: (24.0, None, 0)}, 0.8)
    (row,) = study.table()
    assert row["critical"].value == row["harm"].value == pytest.approx(2 / 5)
    assert row["collided"].value == pytest.approx(1 / 5)
    assert row["ttc_before_s"].value == 3.0
    assert row["ttc_after_s"].value == 3.0, "a median; nothing ahead counts as infinite"
    assert row["shift_m"].value == pytest.approx(0.8)
    text = " ".join(conclusion(study.table()))
    assert "is unsafe on 40 % [5, 85] of 5 roads" in text
    tables = study.tables(study.table())
    ours = [line for line in tables.tables[0].lines if line[0] == "suppressed leader, 5 frames, 0.5 m each"]
    assert len(ours) == sum(case == "leader" for case, *_ in PUBLISHED)
    assert ours[0][2:4] == ["40", "30 (of 30: 40, 30, 20)"]


def test_a_study_without_trials_has_empty_tables() -> None:
    study = PosePerturbation({"twin": factors_of("leader", 0), "attack": factors_of("leader", 40)}, ["road"], range(2))
    (row,) = study.table()
    assert row.trials == 0
    assert math.isnan(row["harm"].value)
    assert conclusion(study.table()) == []


def test_the_presets_pair_each_attack_with_a_twin() -> None:
    study = definition.load("posepert")
    cells = set(study.factors.values())
    assert len(cells) == 28
    assert {cell["defence"] for cell in cells} == {"", "Cad", "Made", "PoseGuard"}
    assert all(cell.but(frames=0, step_m=0.0) in cells for cell in cells)
    assert len(definition.load("posepert", ["preset=quick"]).factors) == 14
    undefended = definition.load("posepert", ["defences=none", "cases=leader"]).factors
    assert list(undefended) == [
        "leader, no attack, none",
        "leader, 40 frames 0.5 m, none",
        "leader, to the end 0.5 m, none",
    ]


@pytest.mark.heavy
@pytest.mark.usefixtures("unpainted")
def test_a_shared_vehicle_is_perceived_aside(tmp_path: Path) -> None:
    finished = mast.study(
        "posepert", out=tmp_path / "study", trials=2, jobs=1, frames=60, defences="PoseGuard", cases="cut_in"
    )
    with (finished.path / "posepert.csv").open() as file:
        rows = {(row["attack"], row["measure"]): float(row["value"]) for row in csv.DictReader(file)}
    assert 0.1 < rows["phantom cut-in, 40 frames, 0.5 m each", "shift_m"] <= 1.2
    assert (
        rows["phantom cut-in, 40 frames, 0.5 m each", "alarms"]
        > rows["phantom cut-in, 40 frames, 0.5 m each", "false_alarms"]
    )
    assert (finished.path / "posepert.png").is_file()
