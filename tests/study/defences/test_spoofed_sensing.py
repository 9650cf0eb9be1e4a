"""How far attacks on a lidar get, link by link: shares of frames and runs, and sentences about them."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import definition
from mast_zenoh.study.defences.kinds import Factors
from mast_zenoh.study.defences.spoofed_sensing import LINKS, SpoofedSensing, conclusion

SEEDS = 6


def factors_of(attack: str, check: str = "") -> Factors:
    budget, distance = ("200 points", "8 m") if attack else ("", "")
    return Factors(attack=attack, budget=budget, distance=distance, check=check, start_s=4.0)


def trial(label: str, seed: int, needless: int, hits: int = 0, **part: float) -> Any:
    measured = dict(frames=50, period_s=0.1, landed=60, points=190.0, detected=30, tracked=25, fused=20) | part
    driven = {"ego": {"needless_brakes": needless, "collisions": [{}] * hits}}
    return outcome(label, "junction", seed, {"frames": 100, "defence": measured, "driven": driven})


@pytest.fixture
def study() -> SpoofedSensing:
    """An attack that brakes the car on half of the seeds, and that a check keeps from being tracked."""
    cells = {
        f"{attack or 'twin'} {check}": factors_of(attack, check)
        for attack in ("", "injection")
        for check in ("", "Check")
    }
    study = SpoofedSensing(cells, ["junction"], range(SEEDS))
    for label, factors in cells.items():
        for seed in range(SEEDS):
            if not factors["attack"]:
                study.add(trial(label, seed, seed % 2, landed=0, points=0.0))
            elif factors["check"]:
                study.add(trial(label, seed, seed % 2, detected=3, tracked=0, fused=0))
            else:
                study.add(trial(label, seed, seed % 2 + (seed < 3), tracked=25 + seed))
    return study


def test_links_are_shares_of_the_frames_of_the_attack_and_of_runs_beside_their_twins(study: SpoofedSensing) -> None:
    attacked, checked = study.table()
    assert [row.of["check"] for row in (attacked, checked)] == ["none", "Check"]
    assert attacked.trials == SEEDS
    assert {link: round(attacked[link].value, 3) for link in LINKS} == {
        "landed": 1.0,
        "detected": 0.5,
        "tracked": 0.55,
        "fused": 0.4,
        "braked": 0.5,
    }
    assert attacked["tracked"].low < 0.55 < attacked["tracked"].high, "it differs between seeds"
    assert checked["detected"].value == pytest.approx(0.05)
    assert checked["braked"].value == 0.0


def test_a_collision_counts_as_a_brake_that_came_too_late() -> None:
    cells = {"twin": factors_of(""), "attack": factors_of("removal")}
    study = SpoofedSensing(cells, ["junction"], range(2))
    for seed in range(2):
        study.add(trial("twin", seed, 0))
        study.add(trial("attack", seed, 0, hits=seed))
    assert study.table()[0]["braked"].value == 0.5


def test_sentences_name_the_farthest_attack_where_chains_break_and_what_checks_change(study: SpoofedSensing) -> None:
    sentences = conclusion(study.table())
    assert "injection (200 points, 8 m) gets farthest" in sentences[0]
    assert 'at "fused"' in sentences[1]
    assert "is fused in 0 [0, 46] % instead of 40 %" in sentences[2]
    assert len(sentences) == 3


def test_without_trials_tables_are_empty_and_nothing_is_said() -> None:
    study = SpoofedSensing({"twin": factors_of(""), "attack": factors_of("wall")}, ["junction"], range(2))
    (row,) = study.table()
    assert row.trials == 0
    assert math.isnan(row["landed"].value)
    assert conclusion(study.table()) == []


def test_the_preset_of_an_hour_has_four_attacks_three_budgets_two_checks_and_ten_pairs() -> None:
    hour = definition.load("sensing")
    attacks = [factors for factors in hour.factors.values() if factors["attack"]]
    assert len(attacks) == 4 * 3 * 2
    assert len(hour.scenes) * hour.trials == 10
    assert len(definition.load("sensing", ["preset=quick"]).factors) == 4
    assert {cell["check"] for cell in definition.load("sensing", ["checks=none"]).factors.values()} == {""}
    one = definition.load("sensing", ["preset=quick", "budgets=1", "distances=1"])
    assert "injection, 200 points, 8 m, none" in one.factors, "the largest budget, the nearest distance"
    with pytest.raises(ConfigurationError, match="did you mean 'injection'"):
        definition.load("sensing", ["attacks=injecton"])


@pytest.mark.heavy
@pytest.mark.usefixtures("unpainted")
def test_injected_points_get_from_the_wire_to_the_picture(tmp_path: Path) -> None:
    finished = mast.study("sensing", out=tmp_path / "study", preset="quick", trials=1, jobs=1, frames=80, checks="none")
    with (finished.path / "sensing.csv").open() as file:
        values = {row["measure"]: float(row["value"]) for row in csv.DictReader(file)}
    assert 100.0 < values["points"] <= 200.0
    assert values["landed"] > 0.8
    assert values["detected"] > 0.2
    assert np.isfinite([values[link] for link in LINKS]).all()
    assert (finished.path / "sensing.png").is_file()
