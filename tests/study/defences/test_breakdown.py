"""With how many liars a defence breaks: the share at which a curve reaches one half, and broken trials."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome
from hypothesis import given
from hypothesis import strategies as st

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.metrics.study_results import Row
from mast_zenoh.study.choices import sensors_of
from mast_zenoh.study.defences.breakdown import Breakdown, crossing
from mast_zenoh.study.defences.kinds import Factors


@pytest.mark.parametrize(
    ("x", "shares", "at"),
    [
        ([0.2, 0.4, 0.6], [0.0, 0.25, 0.75], 0.5),
        ([0.2, 0.4], [0.0, 0.5], 0.4),
        ([0.0, 0.2, 0.4, 0.6], [0.0, 1.0, 0.0, 1.0], 0.1),  # the first one
        ([0.0, 0.5], [0.0, 0.49], math.inf),
        ([0.0, 0.5], [0.7, 1.0], 0.0),  # from the beginning
    ],
)
def test_a_crossing_lies_between_its_neighbours(x: list[float], shares: list[float], at: float) -> None:
    assert crossing(x, shares) == pytest.approx(at)


def test_a_crossing_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="x: found no points"):
        crossing([], [])


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=10))
def test_a_crossing_is_never_before_a_point_below_the_level(shares: list[float]) -> None:
    x = np.arange(len(shares), dtype=float)
    crossed = crossing(x, shares)
    reached = [index for index, each in enumerate(shares) if each >= 0.5 - 1e-12]
    assert (crossed == math.inf) == (not reached)
    if reached:
        assert max(0, reached[0] - 1) <= crossed <= reached[0]


AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")


def metrics(liars: int, suspensions: dict[str, float] | None = None, majority: float = 1.0) -> dict[str, Any]:
    """Metrics of a run of ten frames, whose attack begins at 0.5 s; suspensions: s by agent."""
    times = suspensions or {}
    return {
        "agents": {"ego": {}},
        "scored_frames": [0, 8],
        "integrity": {
            "agents": {name: {"suspensions": [{"from_s": times[name]}] if name in times else []} for name in AGENTS}
        },
        "defence": {
            "compromised": sorted(AGENTS[1 : 1 + liars]),
            "honest_majority": majority,
            "frames_s": [0.1 * index for index in range(10)],
        },
    }


def per_frame(picture: int, local: int) -> dict[str, np.ndarray]:
    """Errors in each frame from 0.5 s on; before, and in the frame that is not scored, the picture has 100."""
    early = [100] * 5
    errors = np.array([*early, *[picture] * 4, 100, *[0] * 5, *[local] * 4, 0])
    return {
        "frame": np.tile(np.arange(10), 2),
        "agent": np.full(20, "ego", object),
        "estimator": np.repeat(np.array(["picture", "local"], object), 10),
        "fn": errors // 2,
        "fp": errors - errors // 2,
    }


def collected(*trials: tuple[int, str, dict[str, Any], tuple[int, int]]) -> Breakdown:
    """Of trials: liars, scene, metrics, and errors of picture and ego alone."""
    counts = {each[0] for each in trials}
    factors = {
        str(liars): Factors(attack="Lie" if liars else "", agents=5, liars=liars, attack_start_s=0.5)
        for liars in sorted(counts if any(counts) else {*counts, 4})
    }
    collection = Breakdown(factors, list(dict.fromkeys(each[1] for each in trials)), [0])
    for liars, scene, content, errors in trials:
        collection.add(outcome(str(liars), scene, 0, content, per_frame(*errors)))
    return collection


def rows_of(*trials: tuple[int, str, dict[str, Any], tuple[int, int]]) -> list[Row]:
    """The rows by number of liars, with the values of their measures."""
    return list(collected(*trials).table()[0])


def values(row: Row) -> dict[str, float]:
    return {name: each.value for name, each in row.numbers.items()}


def test_a_picture_worse_than_the_ego_alone_is_broken() -> None:
    without_liars, worse = map(values, rows_of((0, "a", metrics(0), (2, 4)), (1, "a", metrics(1), (5, 4))))
    assert without_liars["broken"] == worse["honest_first"] == 0.0
    assert worse["broken"] == worse["worse"] == 1.0


def test_an_honest_agent_suspended_before_any_liar_is_broken() -> None:
    before = metrics(1, {"ego": 0.6, "infra_1": 0.7})
    after = metrics(1, {"ego": 0.7, "infra_1": 0.6})
    together = metrics(1, {"ego": 0.7, "infra_1": 0.7})
    only = metrics(1, {"ego": 0.7})
    trials = [(1, name, each, (0, 4)) for name, each in zip("abcd", (before, after, together, only), strict=True)]
    (row,) = rows_of(*trials)
    assert (row.trials, values(row)["honest_first"], values(row)["honest_suspended"]) == (4, 0.5, 0.25)


def test_a_false_alarm_that_happens_without_liars_too_was_not_caused_by_them() -> None:
    alarm = metrics(0, {"ego": 0.7})
    rows = rows_of(
        (0, "a", alarm, (0, 4)),
        (1, "a", metrics(1, {"ego": 0.7}), (0, 4)),
        (2, "a", metrics(2, {"ego": 0.6}), (0, 4)),
    )
    without_liars, same, earlier = map(values, rows)
    assert (without_liars["honest_first"], without_liars["honest_suspended"]) == (0.0, 0.2)
    assert (same["honest_first"], same["honest_suspended"]) == (0.0, 0.25)
    assert earlier["honest_first"] == 1.0


def test_the_breakdown_point_is_between_the_shares_around_one_half() -> None:
    # Six scenes: none is broken with one liar of five, half with two, all with three.
    broken, fine = (5, 4), (0, 4)
    _, (points,) = collected(
        *[(1, scene, metrics(1, majority=0.9), fine) for scene in "abcdef"],
        *[(2, scene, metrics(2, majority=0.6), broken if scene in "bdf" else fine) for scene in "abcdef"],
        *[(3, scene, metrics(3, majority=0.2), broken) for scene in "abcdef"],
    ).table()
    point = points.numbers["breakdown_point"]
    assert point.value == pytest.approx(0.4)
    assert values(points)["breakdown_bound"] == pytest.approx(0.45), (
        "a quarter of the way from 40 to 80 % without an honest majority"
    )
    assert values(points)["breakdown_difference"] == pytest.approx(-0.05)
    # Resamples of scenes of one kind alone: half-way between two and three liars, or between one and two.
    assert 0.3 <= point.low < 0.4 < point.high <= 0.5


def test_a_defence_that_never_breaks_has_a_point_beyond_what_was_tried() -> None:
    collection = collected(*[(liars, "a", metrics(liars, majority=0.2), (0, 4)) for liars in (1, 2)])
    table = collection.table()
    assert values(table[1][0])["breakdown_point"] == math.inf
    tables = collection.tables(table)
    assert "| Lie | 5 | > 40 | 20 | > 20 |" in tables.as_markdown()
    assert "Lie,5,,breakdown_point,inf,," in tables.as_csv()
    latex = tables.as_latex()
    assert r"Lie & 5 & $>$ 40 & 20 & $>$ 20 \\" in latex
    assert all(line.isascii() for line in latex.splitlines() if not line.startswith("%"))
    assert "above 40 %" in collection.figures(table)["breakdown"].alt


def test_all_agents_but_the_ego_have_a_pole_or_a_car() -> None:
    assert [sum(sensors_of(count).values()) for count in (2, 5, 13, 21, 29)] == [1, 4, 12, 20, 28]
    assert sensors_of(13) == {"n_infrastructure": 8, "n_mobile": 4}
    with pytest.raises(ConfigurationError, match="agents: found 30, expected whole numbers from 2 to 29"):
        sensors_of(30)


@pytest.mark.heavy
@pytest.mark.usefixtures("unpainted")
def test_a_small_study_with_different_numbers_of_agents_is_carried_out(tmp_path: Path) -> None:
    settings = dict(agents=(2, 3), shares=(0.0, 0.6), adversaries="coordinated", attack_start_s=0.3)
    options = dict(trials=1, jobs=1, frames=14, out=tmp_path / "study", scenes="intersection:60")
    finished = mast.study("breakdown", **options, **settings)  # type: ignore[arg-type]
    names = {path.name for path in finished.path.iterdir()}
    assert {"breakdown.md", "breakdown.csv", "breakdown.png", "report.html"} <= names
    text = (finished.path / "breakdown.csv").read_text()
    assert "coordinated,3,2,honest_majority," in text
    assert "coordinated,2,1,broken," in text
