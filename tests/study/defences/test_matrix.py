"""Every defence against every adversary: lies, traces and estimates of trials."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome
from numpy.typing import NDArray

import mast_zenoh as mast
from mast_zenoh.metrics.study_results import BINOMIAL, Row, Statistic
from mast_zenoh.study.choices import by_coverage, honest_majority
from mast_zenoh.study.defences.kinds import Factors
from mast_zenoh.study.defences.matrix import MAX_AGENTS, DefenceMatrix, doubts, is_fault, panel, undefended
from mast_zenoh.study.defences.matrix_table import MatrixTable
from mast_zenoh.study.defences.matrix_trial import detected_lies, outnumbered, trace

#: Lidar returns of five objects at four agents.
POINTS = np.array([[9, 9, 9, 0], [9, 0, 0, 0], [9, 9, 0, 0], [0, 0, 9, 9], [4, 0, 0, 0]])


def test_an_honest_majority_is_the_share_of_seen_objects_where_liars_are_outnumbered() -> None:
    assert honest_majority(POINTS, [False] * 4) == 1.0
    # Agent 0 lies: outnumbered at object 0 alone; tied at object 2, alone at object 1, absent at object 3.
    assert honest_majority(POINTS, [True, False, False, False]) == 2 / 4, "a tie is no majority"
    assert np.isnan(honest_majority(POINTS[4:], [False] * 4)), "objects that nobody sees do not count"


def test_agents_that_cover_more_objects_come_first() -> None:
    assert by_coverage(POINTS).tolist() == [0, 1, 2, 3]
    assert by_coverage(POINTS[3:4]).tolist() == [2, 3, 0, 1]


#: Of one agent, about one object: the effect, whether it could be observed in three frames, in which frames the object
#: was withheld and the agent suspended, and whether that detects the lie.
DETECTED = [
    ("inserted", "ooo", "---", "---", 0),
    ("inserted", "ooo", "-x-", "---", 0),  # withheld for a moment
    ("inserted", "ooo", "-xx", "---", 1),
    ("inserted", "-o-", "x--", "---", 0),  # by chance, before it could be observed
    ("inserted", "-o-", "--x", "---", 1),
    ("removed", "ooo", "xxx", "---", 0),  # by suspension alone
    ("removed", "ooo", "---", "-x-", 1),
]


def lies(*rows: tuple[str, str, int, bool]) -> dict[str, Any]:
    """Columns of lies from rows of agent, effect, id, observable; one more frame each."""
    agent, effect, id_, observable = (np.array(column) for column in zip(*rows, strict=True))
    return dict(frame=np.arange(len(rows)), agent=agent, effect=effect, id=id_, observable=observable)


def marked(text: str) -> NDArray[np.bool_]:
    return np.array([each != "-" for each in text], bool)


@pytest.mark.parametrize(("effect", "observable", "withheld", "suspended", "detected"), DETECTED)
def test_a_lie_is_detected_by_suspension_or_by_withholding_its_object(
    effect: str, observable: str, withheld: str, suspended: str, detected: int
) -> None:
    claims = lies(*(("a", effect, 7, bool(each)) for each in marked(observable)))
    counts = detected_lies(claims, marked(withheld), marked(suspended))
    assert counts == {"all": 1, "observable": 1, "detected": detected}


def test_a_lie_is_all_that_one_agent_tells_about_one_object() -> None:
    claims = lies(("a", "inserted", 7, True), ("a", "inserted", 7, True), ("b", "inserted", 7, False))
    assert detected_lies(claims, marked("---"), marked("---")) == {"all": 2, "observable": 1, "detected": 0}
    claims = lies(("a", "inserted", 7, True), ("a", "inserted", 7, True), ("a", "inserted", 8, True))
    assert detected_lies(claims, marked("-x-"), marked("---")) == {"all": 2, "observable": 2, "detected": 1}
    none = {name: column[:0] for name, column in claims.items()}
    assert detected_lies(none, marked(""), marked("")) == {"all": 0, "observable": 0, "detected": 0}


def kept(**changes: Any) -> dict[str, Any]:
    """The trace of one honest agent, changed."""
    states: dict[str, list[list[float]]] = {name: [] for name in ("faulty", "suspended", "undecided")}
    quiet = dict(time_s=[0.0, 0.2], log_odds=[None, 4.0], states=states, lies=[], faults=[])
    return quiet | changes


def test_of_many_agents_those_that_lie_fail_or_are_suspended_are_shown() -> None:
    agents = {f"agent_{index}": kept() for index in range(9)}
    agents["agent_6"] = kept(lies=[[1.0, 2.0]])
    agents["agent_7"] = kept(faults=[["Loss", 1.0, 2.0]])
    agents["agent_8"] = kept(states={"faulty": [], "suspended": [[1.0, 2.0]], "undecided": []})
    drawn = panel({"end_s": 3.0, "agents": agents}, "title")
    assert [agent.agent for agent in drawn.agents] == ["agent_0", "agent_1", "agent_6", "agent_7", "agent_8"]
    assert (len(drawn.agents), drawn.left_out) == (MAX_AGENTS, 4)


@pytest.mark.parametrize(("state", "shown"), [("suspended", True), ("undecided", True), ("faulty", False)])
def test_a_defence_that_suspends_an_agent_or_leaves_one_undecided_has_panels(state: str, shown: bool) -> None:
    states = kept()["states"] | {state: [[1.0, 2.0]]}
    assert doubts({"agents": {"agent_0": kept(), "agent_1": kept(states=states)}}) == shown
    assert not doubts({"agents": {"agent_0": kept()}})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run of 4 s whose liar begins at 2 s."""
    settings = dict(attack="Flood", placement="poles", n_adversaries=1, attack_start_s=2.0)
    folder = tmp_path_factory.mktemp("traces") / "run"
    options = dict(frames=40, runtime="inproc", seed=3, out=folder, scene="intersection:9")
    soon = dict(type="SequentialConsistency", contradiction_tail=(78.0, 0.1), pair_tail=(43.0, 0.1))
    defence = dict(type="FaultOrLie", stage=soon)
    return mast.run("defence_cell", defence=defence, **options, **settings)  # type: ignore[arg-type]


def test_a_trace_survives_json_and_has_lies_and_suspensions(run: mast.Run) -> None:
    content = trace(run)
    assert content is not None
    text = json.dumps(content, allow_nan=False)
    assert len(text) < 4000, "every trial of a study keeps it"
    content = json.loads(text)
    drawn = panel(content, "title")
    agents = {agent.agent: agent for agent in drawn.agents}
    assert list(agents) == ["ego", "infra_1", "infra_2", "infra_3", "infra_4"]
    assert drawn.end_s == pytest.approx(4.0)
    (begin, end), *_ = agents["infra_1"].lies
    assert begin == pytest.approx(2.0, abs=0.3)
    assert doubts(content)
    assert begin <= agents["infra_1"].states["suspended"][0][0] < 4.0
    assert agents["infra_1"].value[-1] < 0.0 < agents["infra_2"].value[-1]
    assert len(agents["ego"].time_s) == pytest.approx(20, abs=1), "twice as coarse as the frames"
    assert end <= 4.1


def test_only_observable_lies_can_be_outnumbered() -> None:
    lies: dict[str, Any] = dict(
        observable=[True, True, True, False], honest_viewers=[2, 1, 1, 0], lying_viewers=[1, 1, 2, 3]
    )
    assert outnumbered(lies) == pytest.approx(1 / 3), "a tie outnumbers nobody"
    assert outnumbered({name: column[3:] for name, column in lies.items()}) is None


SEEDS = range(5)


def cell(
    defence: str, attack: str = "", n_adversaries: int = 0, placement: str = "", budget: float | None = None
) -> Factors:
    return Factors(defence=defence, attack=attack, n_adversaries=n_adversaries, placement=placement, budget=budget)


def label_of(factors: Factors) -> str:
    return " ".join(map(str, factors.values()))


def collection_of(cells: Iterable[Factors], seeds: Sequence[int]) -> DefenceMatrix:
    return DefenceMatrix({label_of(each): each for each in cells}, ["junction"], seeds)


CELLS = (
    cell("NoIntegrity"),
    cell("Wall"),
    *(cell(defence, "Ghost", 1, "worst", budget) for defence in ("NoIntegrity", "Wall") for budget in (1.0, 4.0)),
)


def metrics(
    fp: float,
    *,
    trusted: bool = False,
    lied: bool = False,
    suspended_after_s: float | None = None,
    suspended_before: bool = False,
    alarms: int = 0,
    honest_suspended_s: float | None = None,
    outnumbered: float = 0.0,
) -> dict[str, Any]:
    """metrics.json of a trial of 36 s with one agent that may lie and one that never does.

    honest_suspended_s: s of scene time at which the latter is suspended
    suspended_before: whether the liar is suspended before its first lie
    """
    picture = {"fn": {"mean": 2.0}, "fp": {"mean": fp}, "ospa_m": {"mean": 1.0 + fp}}
    liar = {
        "first_lie_s": 4.0,
        "first_observable_s": 4.0,
        "suspended_after_s": suspended_after_s,
        "observed_s": 6.0 if suspended_after_s is None else suspended_after_s,
    }
    if suspended_before or not trusted:
        liar["observed_s"] = None
    detected = suspended_after_s is not None
    suspension = [] if honest_suspended_s is None else [{"from_s": honest_suspended_s, "conduct": "honest"}]
    content: dict[str, Any] = {
        "frames": 360,
        "agents": {"ego": {"picture": picture}},
        "defence": {
            "first_attack_s": 4.0 if lied else None,
            "lies": {"all": 4 * lied, "observable": 4 * lied, "detected": 2 * detected},
            "agents": {"liar": liar} if lied else {},
            "false": {"identifiable": fp, "unidentifiable": 0.0},
            "honest_majority": 0.75 if lied else 1.0,
            "outnumbered": outnumbered if lied else None,
        },
    }
    if trusted:
        content["integrity"] = {
            "agents": {
                "liar": {
                    "lied": lied,
                    "suspicion": {"max": 3.0 if lied else -3.0},
                    "fault_alarms": 2,
                    "suspensions": [],
                },
                "honest": {"lied": False, "suspicion": {"max": -2.0}, "fault_alarms": 0, "suspensions": suspension},
            },
            "seconds": {"honest": {"trusted": 36.0, "suspended": 4.0}},
            "hours": 0.01,
            "false_alarms": alarms + len(suspension),
        }
    return content


@pytest.fixture
def matrix() -> MatrixTable:
    collection = collection_of(CELLS, list(SEEDS))
    for seed in SEEDS:
        noise = 0.1 * seed
        trials = {
            cell("NoIntegrity"): metrics(noise),
            cell("Wall"): metrics(noise + 0.5, trusted=True, alarms=seed == 0),
            cell("NoIntegrity", "Ghost", 1, "worst", 1.0): metrics(noise + 2.0, lied=True),
            cell("NoIntegrity", "Ghost", 1, "worst", 4.0): metrics(noise + 4.0 + noise, lied=True),
            cell("Wall", "Ghost", 1, "worst", 1.0): metrics(noise + 1.0 + noise, trusted=True, lied=True),
            cell("Wall", "Ghost", 1, "worst", 4.0): metrics(noise, trusted=True, lied=True, suspended_after_s=1.0),
        }
        for each, content in trials.items():
            collection.add(outcome(label_of(each), "junction", seed, content))
    return collection.table()


def measure(matrix: MatrixTable, defence: str, name: str, attack: str = "Ghost", count: int = 1) -> Statistic:
    row = matrix.row(defence, attack, count, "worst")
    assert row is not None
    return row.numbers[name]


def test_damage_is_relative_to_no_attack_and_no_defence_with_the_same_seed(matrix: MatrixTable) -> None:
    damage = measure(matrix, "NoIntegrity", "damage")
    assert damage.value == pytest.approx(4.2)
    assert 4.0 <= damage.low < 4.2 < damage.high <= 4.4, "paired, so that the seeds' own noise cancels"


def test_each_cell_has_the_budget_that_does_the_most_damage(matrix: MatrixTable) -> None:
    undefended, defended = (matrix.row(name, "Ghost", 1, "worst") for name in ("NoIntegrity", "Wall"))
    assert undefended is not None
    assert defended is not None
    assert [undefended.of["budget"], defended.of["budget"], defended.of["budgets"]] == [4.0, 1.0, 2]
    # 1.2 against the undefended run with the same budget, 2.0
    assert defended.numbers["fp_vs_undefended"].value == pytest.approx(1.2 - 2.0)


def test_the_cost_is_the_damage_without_an_attack(matrix: MatrixTable) -> None:
    assert matrix.row("Wall", "Ghost", 0, "worst").of["attack"] == ""  # type: ignore[union-attr]
    assert measure(matrix, "Wall", "fp_added", count=0).value == pytest.approx(0.5)
    assert measure(matrix, "Wall", "faulty_suspended_per_hour", count=0).value == pytest.approx(200.0)
    assert math.isnan(measure(matrix, "Wall", "lies_detected", count=0).value), "none is observable"


def test_delays_characteristics_and_time_in_each_state_are_over_all_trials_of_a_defence(matrix: MatrixTable) -> None:
    assert set(matrix.delays) == {"Wall"}, "without trust nobody is watched"
    delay = matrix.delays["Wall"]
    assert (delay.detections, delay.watched, delay.median_s) == (5, 10, 1.0)
    (summary,) = matrix.summaries
    assert (list(matrix.rocs), summary["auc"].value) == (["Wall"], 1.0)
    assert math.isnan(summary["auc"].low), "a perfect separation in all trials does not say how good it is in others"
    assert summary["hours"].value == pytest.approx(15 * 0.01)
    (honest,) = matrix.states
    assert honest.of == {"defence": "Wall", "conduct": "honest"}
    assert honest["suspended"].value == pytest.approx(0.1)


def test_a_failed_trial_is_left_out() -> None:
    collection = collection_of(CELLS[:2], [0, 1])
    collection.add(outcome(label_of(CELLS[0]), "junction", 0, metrics(1.0)))
    collection.add(outcome(label_of(CELLS[1]), "junction", 0, metrics(2.0, trusted=True)))
    collection.add(outcome(label_of(CELLS[1]), "junction", 1, metrics(9.0, trusted=True)))
    added = collection.table().rows[1].numbers["fp_added"]
    assert (added.value, added.trials, added.left_out) == (1.0, 1, 1)


def test_the_share_removed_is_relative_to_the_undefended_run_with_the_same_seed(matrix: MatrixTable) -> None:
    removed = measure(matrix, "Wall", "identifiable_removed")
    # 1.4 a frame remain of 2.2, over all seeds together
    assert removed.value == pytest.approx(1.0 - (1.2 + 0.2) / (2.0 + 0.2))
    assert removed.low < removed.value < removed.high
    assert math.isnan(measure(matrix, "NoIntegrity", "identifiable_removed").value)


def played(*contents: dict[str, Any], attacked: Factors = CELLS[-1]) -> MatrixTable:
    """A matrix of one attacked cell of `Wall`, a seed for each metrics.json, and the runs that it is compared with."""
    cells = (cell("NoIntegrity"), cell("Wall"), undefended(attacked), attacked)
    collection = collection_of(cells, range(len(contents)))
    for seed, content in enumerate(contents):
        for each in cells:
            trusted, lied = each["defence"] == "Wall", bool(each["attack"]) and not is_fault(attacked)
            other = metrics(3.0 if each["attack"] else 1.0, trusted=trusted, lied=lied)
            collection.add(outcome(label_of(each), "junction", seed, content if each == attacked else other))
    return collection.table()


def test_an_honest_agent_is_framed_if_it_is_suspended_after_the_first_lie() -> None:
    before, after = (metrics(1.0, trusted=True, lied=True, honest_suspended_s=at_s) for at_s in (3.9, 4.0))
    framed = measure(played(before, after, after, after), "Wall", "framed")
    assert (framed.value, framed.trials, framed.interval) == (0.75, 4, BINOMIAL)
    assert (framed.low, framed.high) == (pytest.approx(0.194, abs=1e-3), pytest.approx(0.994, abs=1e-3))


def test_framing_by_a_local_majority_is_counted_apart() -> None:
    framed, not_framed = dict(honest_suspended_s=5.0), dict(honest_suspended_s=None)
    trials = [
        metrics(1.0, trusted=True, lied=True, outnumbered=share, **choice)  # type: ignore[arg-type]
        for share, choice in ((0.0, not_framed), (0.4, not_framed), (0.49, framed), (0.5, framed), (1.0, framed))
    ]
    matrix = played(*trials)
    minority, majority = (measure(matrix, "Wall", f"framed_by_{group}") for group in ("minority", "majority"))
    assert (minority.value, minority.trials) == (pytest.approx(1 / 3), 3)
    assert (majority.value, majority.trials) == (1.0, 2)
    assert matrix.summaries[0].numbers["framed_by_minority"] == minority


def test_a_run_with_faults_alone_that_suspends_an_agent_is_wrong_and_not_framing() -> None:
    suspended, kept = (metrics(1.0, trusted=True, honest_suspended_s=at_s) for at_s in (5.0, None))
    matrix = played(suspended, kept, attacked=cell("Wall", "fault:pose", 1, "random"))
    row = next(row for row in matrix.rows if row.of["defence"] == "Wall" and row.of["attack"])
    assert (row.numbers["wrongly_suspended"].value, row.numbers["wrongly_suspended"].trials) == (0.5, 2)
    assert math.isnan(row.numbers["framed"].value)
    (summary,) = matrix.summaries
    assert summary.numbers["faults_suspended"].value == 0.5
    assert math.isnan(summary.numbers["lies_detected"].value)


def test_the_summary_has_the_alarms_of_unattacked_runs_and_their_frames(matrix: MatrixTable) -> None:
    (summary,) = matrix.summaries
    assert summary.of == {"defence": "Wall"}
    assert summary.numbers["alarms_per_hour"] == measure(matrix, "Wall", "honest_suspended_per_hour", count=0)
    assert summary.numbers["frames"].value == 5 * 360
    assert summary.numbers["fp_added"].value == pytest.approx(0.5)
    assert summary.numbers["lies_detected"].value == 0.0, "the worst budget was not detected"


def test_the_runs_of_one_scene_and_seed_are_one_trial_of_a_defence() -> None:
    cells = [cell("NoIntegrity"), *(cell("Wall", attack, 1, "worst") for attack in ("a", "b", "c"))]
    collection = collection_of(cells, SEEDS)
    for seed in SEEDS:
        for each in cells:
            content = metrics(1.0, trusted=each["defence"] == "Wall", lied=bool(each["attack"]))
            collection.add(outcome(label_of(each), "junction", seed, content))
    (summary,) = collection.table().summaries
    framed = summary.numbers["framed_by_minority"]
    assert (framed.value, framed.trials) == (0.0, 15)
    assert framed.high == pytest.approx(1.0 - 0.025 ** (1 / 5))


def test_an_unknown_median_delay_has_at_most_a_lower_bound() -> None:
    never, soon = (metrics(1.0, trusted=True, lied=True, suspended_after_s=after_s) for after_s in (None, 1.0))
    unknown = measure(played(never, never, never, never, soon, soon), "Wall", "median_delay_s")
    assert math.isnan(unknown.value)
    assert (unknown.low, unknown.high) == (1.0, math.inf)
    known = measure(played(soon, soon, soon, soon, soon, never), "Wall", "median_delay_s")
    assert (known.value, known.low) == (1.0, 1.0)


def row_of(matrix: MatrixTable) -> Row:
    """The row of `Wall` under attack."""
    return next(row for row in matrix.rows if row.of["defence"] == "Wall" and row.of["attack"])


def test_adversaries_that_never_lie_frame_nobody_and_their_runs_count_as_runs_without_lies() -> None:
    silent = metrics(1.0, trusted=True, honest_suspended_s=5.0)
    row = row_of(played(silent, silent, silent, silent))
    assert math.isnan(row.numbers["framed"].value)
    wrong = row.numbers["wrongly_suspended"]
    assert (wrong.value, wrong.trials) == (1.0, 4)
    assert row.idle
    assert (row.numbers["attacked"].value, row.numbers["attacked"].trials) == (0.0, 4)


def test_only_runs_with_a_lie_say_what_a_defence_removes_and_tells_apart() -> None:
    silent, attacked = (metrics(fp, trusted=True, lied=lied) for fp, lied in ((0.0, False), (1.5, True)))
    half = played(silent, silent, attacked, attacked)
    row = row_of(half)
    assert (row.numbers["attacked"].value, row.idle) == (0.5, False)
    removed = row.numbers["identifiable_removed"]
    assert (removed.value, removed.trials, removed.left_out) == (pytest.approx(1.0 - 1.5 / 3.0), 2, 2)
    curve = half.rocs["Wall"]
    assert (curve.honest, curve.liars) == (2 + 4 * 2, 2), "runs without an attack count"
    never = played(silent, silent)
    assert math.isnan(row_of(never).numbers["identifiable_removed"].value)
    assert math.isnan(never.summaries[0].numbers["identifiable_removed"].value)
    assert never.rocs == {}


def test_a_false_alarm_before_the_first_lie_is_no_delay_and_is_counted_apart() -> None:
    before, after = (
        metrics(1.0, trusted=True, lied=True, suspended_after_s=2.0),
        metrics(1.0, trusted=True, lied=True, suspended_before=True),
    )
    row = row_of(played(before, after))
    names = ("suspended_before", "liars_suspended", "liars_watched", "median_delay_s")
    assert [row.numbers[name].value for name in names] == [1, 1, 1, 2.0]


def test_a_defence_that_suspends_nobody_has_no_delay_and_no_curve() -> None:
    watched = metrics(1.0, trusted=True, lied=True)
    suspending = played(watched)
    assert list(suspending.delays) == ["Wall"]
    assert suspending.not_suspending == []
    collection = collection_of(CELLS[:2] + CELLS[-1:], [0])
    for each in (CELLS[1], CELLS[-1]):
        content = metrics(1.0, trusted=True, lied=bool(each["attack"]))
        content["integrity"]["seconds"] = {"honest": {"trusted": 40.0, "suspended": 0.0}}
        collection.add(outcome(label_of(each), "junction", 0, content))
    matrix = collection.table()
    assert (matrix.delays, matrix.not_suspending) == ({}, ["Wall"])
    measured = row_of(matrix).numbers["median_delay_s"]
    assert measured == Statistic(), "not: not reached"


def test_the_area_below_one_alarm_per_hour_needs_an_hour() -> None:
    short = played(metrics(1.0, trusted=True, lied=True))
    assert short.summaries[0]["auc"].known
    assert not short.summaries[0]["partial_auc"].known
    hours = [metrics(1.0, trusted=True, lied=True) for _ in range(2)]
    for content in hours:
        content["integrity"]["hours"] = 0.5
    assert played(*hours).summaries[0]["partial_auc"].value == 1.0
