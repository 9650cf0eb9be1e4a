"""How far a lie reaches, by where tracks are fused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.study import definition
from mast_zenoh.study.defences.cooperation import Cooperation, conclusion
from mast_zenoh.study.defences.kinds import Factors

FRAMES = 10
START_S = 0.5


def factors_of(architecture: str, agents: int, attacked: bool, attack_start_s: float = START_S) -> Factors:
    return Factors(architecture=architecture, agents=agents, attacked=attacked, attack_start_s=attack_start_s)


def trial(label: str, seed: int, false: float, deceived: float, busy: float | None = None) -> Any:
    """A trial of ten frames; before the attack there are nine false objects a frame, and everybody is deceived."""
    metrics: dict[str, Any] = {
        "scored_frames": [0, FRAMES - 1],
        "agents": {"ego": {}, "infra_1": {}},
        "consistency": {
            name: {"picture": {"position": {"nees": nees}}} for name, nees in (("ego", 1.0), ("infra_1", 3.0))
        },
        "defence": {
            "frames_s": [0.1 * frame for frame in range(FRAMES)],
            "deceived": [1.0] * 5 + [deceived] * 5,
            "kb_per_s": 4.0,
            "penetration": 0.25,
        },
    }
    if busy is not None:
        metrics["channel"] = {"busy_ratio": {"mean": busy}}
    per_frame = {
        "agent": np.repeat(["ego", "infra_1"], FRAMES).astype(object),
        "estimator": np.full(2 * FRAMES, "picture", object),
        "frame": np.tile(np.arange(FRAMES), 2),
        "fn": np.repeat([1.0, 50.0], FRAMES),
        "fp": np.concatenate([[9.0] * 5, [false] * 5, [50.0] * FRAMES]),
    }
    return outcome(label, "junction", seed, metrics, per_frame)


def trials_of(architectures: dict[str, tuple[float, float]], seeds: int = 6) -> Cooperation:
    """Trials of architectures with (false objects, deceived share) under lies.

    On odd seeds there is one false object more, with lies or without.
    """
    cells = {
        f"{architecture} {attacked}": factors_of(architecture, 5, attacked)
        for architecture in architectures
        for attacked in (False, True)
    }
    collection = Cooperation(cells, ["junction"], range(seeds))
    for label, cell in cells.items():
        for seed in range(seeds):
            odd = float(seed % 2)
            false, deceived = architectures[cell["architecture"]] if cell["attacked"] else (0.0, 0.0)
            busy = 0.5 if cell["architecture"] == "radio" else None
            collection.add(trial(label, seed, odd + false, deceived, busy))
    return collection


def rows_of(architectures: dict[str, tuple[float, float]]) -> list[Row]:
    return trials_of(architectures).table()


def test_a_trial_counts_from_the_start_of_the_attack_on_and_is_paired_with_the_one_without_lies() -> None:
    (row,) = rows_of({"centre": (2.0, 1.0)})
    values = {name: each.value for name, each in row.numbers.items() if each.known}
    assert (row.of, row.trials) == ({"architecture": "centre", "agents": 5}, 6)
    assert (values["errors"], values["harm"]) == (1.5, 2.0)
    assert row.numbers["errors"].low < 1.5 < row.numbers["errors"].high
    assert (values["deceived"], values["nees"], values["penetration"]) == (1.0, 2.0, 0.25)
    assert not {"busy_ratio", "gospa_m"} & values.keys()


def test_places_are_compared_with_the_first_one() -> None:
    rows = rows_of({"centre": (2.0, 1.0), "peers": (2.0, 0.5), "radio": (3.0, 0.5)})
    assert [row.numbers["harm_difference"].value for row in rows] == [0.0, 0.0, 1.0]
    assert rows[2].numbers["busy_ratio"].value == 0.5


def test_the_conclusion_names_what_differs_and_what_does_not() -> None:
    def row(architecture: str, more: tuple[float, float, float]) -> Row:
        (known,) = rows_of({"centre": (2.0, 0.5)})
        difference = known.numbers["harm_difference"]._replace(
            value=more[0], low=more[1], high=more[2], p=0.001 if more[1] > 0.0 else 0.4
        )
        numbers = {**known.numbers, "harm_difference": difference}
        return replace(known, of={"architecture": architecture, "agents": 5}, numbers=numbers)

    rows = [row("centre", (0.0, 0.0, 0.0)), row("peers", (0.1, -0.2, 0.4)), row("radio", (0.7, 0.3, 1.1))]
    said = conclusion(rows)
    assert "Different from centre: radio (by 0.70 [0.30, 1.10])." in said
    assert "No difference from centre is shown for peers." in said


def test_a_trial_without_its_pair_makes_no_row_and_no_figure(tmp_path: Path) -> None:
    collection = Cooperation({"peers": factors_of("peers", 5, True)}, ["junction"], [0])
    collection.add(trial("peers", 0, 1.0, 1.0))
    table = collection.table()
    assert table == []
    assert conclusion(table) == ""
    assert collection.write(tmp_path).figures == {}


def test_tables_and_figure_are_written(tmp_path: Path) -> None:
    trials_of({"centre": (2.0, 1.0), "radio": (3.0, 0.5)}).write(tmp_path)
    assert "| radio | 5 | 6 | 25 |" in (tmp_path / "cooperation.md").read_text()
    assert "radio,5,busy_ratio,0.5," in (tmp_path / "cooperation.csv").read_text()
    assert (tmp_path / "cooperation.png").stat().st_size > 10_000


def test_the_deceived_share_of_a_run_is_that_of_its_metrics(tmp_path: Path) -> None:
    run = mast.run(
        "peers", out=tmp_path / "run", runtime="inproc", frames=40, report=False, n_adversaries=1, attack_start_s=2.0
    )
    metrics = run.summary
    part = Cooperation.evaluate(run, ["infra_1"])
    cell = factors_of("peers", 7, attacked=True, attack_start_s=1.0)
    columns = dict(agent="ego", estimator="picture", frame=25, fn=1.0, fp=1.0)
    per_frame = {name: np.array([value], object) for name, value in columns.items()}
    trial_of_run = outcome("peers", "junction", 0, metrics | {"defence": part}, per_frame)
    record = Cooperation({"peers": cell}, ["junction"], [0]).measures(cell, trial_of_run)
    _, last = metrics["scored_frames"]
    measured = metrics["pictures"]["deceived"]
    assert part["lies_from_s"] == measured["lies_from_s"] == 2.0
    assert record["deceived"] == pytest.approx(measured["share"]["mean"])
    assert record["deceived"] == pytest.approx(np.mean(part["deceived"][20 : last + 1])), "not the frames before"
    assert record["deceived_max"] == pytest.approx(measured["most"])
    assert max(part["deceived"]) == pytest.approx(6 / 7)  # the liar's own picture is right
    assert 50.0 < part["kb_per_s"] < 500.0
    assert 0.0 < part["penetration"] < 1.0


def test_the_shipped_study_pairs_every_place_and_number_of_agents() -> None:
    study = definition.load("cooperation", ["agents=5,9"])
    assert {(cell["architecture"], cell["agents"], cell["attacked"]) for cell in study.factors.values()} == {
        (architecture, agents, attacked)
        for architecture in ("centre", "regions", "peers", "radio")
        for agents in (5, 9)
        for attacked in (False, True)
    }
