"""Trust compared with conduct, and ROC curves, on hand-made tables."""

from typing import Any

import numpy as np
import pytest

from mast_zenoh.evaluation.trust import integrity
from mast_zenoh.metrics.trust import (
    Conduct,
    TrustHistory,
    TrustUpdate,
    agent_table,
    auc,
    fault_frames,
    lasting,
    object_table,
    partial_auc,
    roc,
    summary,
)

STATES = ("unknown", "trusted", "faulty", "suspended", "undecided")
UNKNOWN, TRUSTED, FAULTY, SUSPENDED, UNDECIDED = range(5)
AGENTS = ("a", "b")


def update(frame: int, states: dict[str, int], log_odds: float = 1.0, objects: int = 0) -> TrustUpdate:
    """A trust message about some agents."""
    a, zeros = len(states), np.zeros(len(states))
    return TrustUpdate(
        frame,
        {
            "agents": list(states),
            "mean": zeros + 0.5,
            "log_odds": zeros + log_odds,
            "state": np.array(list(states.values()), np.uint8),
            "reason": [f"reason {frame}" if state >= SUSPENDED else "" for state in states.values()],
            "fault_offset": np.zeros((a, 2)),
            **dict.fromkeys(("fault_turn", "fault_delay", "fault_loss"), zeros),
            "id": np.arange(objects),
            "position": np.ones((objects, 3)),
            "size": np.ones((objects, 3)),
            "yaw": np.zeros(objects),
            "trust": np.ones(objects),
            **{name: np.zeros(objects, np.int64) for name in ("expected", "confirming", "contradicting")},
            "withheld": np.ones(objects, np.uint8),
        },
    )


def frames_of(*rows: int, length: int = 20) -> np.ndarray:
    """(length, 2) whether something happened to agent a in these frames."""
    result = np.zeros((length, 2), bool)
    result[list(rows), 0] = True
    return result


def summarised(states: list[int], lies: tuple[int, ...] = (), faults: tuple[int, ...] = (), last: int = 0) -> Any:
    """The summary of agent a with these states in frames of 0.1 s, and of the run."""
    updates = [update(frame, {"a": state, "b": TRUSTED}) for frame, state in enumerate(states)]
    n = len(states)
    history = TrustHistory.of(updates, AGENTS, np.arange(n))
    conduct = Conduct(frames_of(*lies, length=n), frames_of(*faults, length=n), last)
    whole = summary(history, conduct, AGENTS, np.arange(n) * 0.1, 0.1, STATES)
    return whole["agents"]["a"], whole


def test_a_state_holds_until_the_next_message_about_its_agent() -> None:
    updates = [update(1, {"a": TRUSTED, "b": TRUSTED}), update(3, {"a": SUSPENDED}), update(5, {"b": FAULTY})]
    history = TrustHistory.of(updates, AGENTS, np.arange(7))
    assert history.state[:, 0].tolist() == [UNKNOWN, TRUSTED, TRUSTED, *[SUSPENDED] * 4]
    assert history.state[:, 1].tolist() == [UNKNOWN, *[TRUSTED] * 4, FAULTY, FAULTY]
    assert history.reason[:, 0].tolist() == ["", "", "", *["reason 3"] * 4]
    assert np.isfinite(history.log_odds[:, 0]).tolist() == [False, True, False, True, False, False, False]


def test_messages_about_unknown_frames_and_agents_are_left_out() -> None:
    history = TrustHistory.of([update(9, {"a": SUSPENDED}), update(0, {"c": SUSPENDED})], AGENTS, np.arange(2))
    assert not history.state.any()


def test_an_event_lasts_for_its_frame_and_some_after() -> None:
    assert np.flatnonzero(lasting(frames_of(3, 8), 2)[:, 0]).tolist() == [3, 4, 5, 8, 9, 10]
    assert not lasting(frames_of(), 5).any()
    assert np.flatnonzero(lasting(frames_of(0), 0)[:, 0]).tolist() == [0]


def test_a_fault_acts_from_its_beginning_to_before_its_end() -> None:
    times_s = np.arange(10) * 0.5
    faults = {"a": [("Loss", 1.0, 2.0)], "b": [("Delay", 4.0, None)]}
    acting = fault_frames(faults, AGENTS, times_s)
    assert np.flatnonzero(acting[:, 0]).tolist() == [2, 3]
    assert np.flatnonzero(acting[:, 1]).tolist() == [8, 9]


def test_a_liar_is_detected_from_its_first_lie_on() -> None:
    agent, whole = summarised([TRUSTED] * 10 + [SUSPENDED] * 10, lies=(4, 5))
    assert agent["lied"]
    assert agent["first_lie_s"] == pytest.approx(0.4)
    assert agent["suspended_after_s"] == pytest.approx(0.6) == agent["observed_s"]
    assert whole["false_alarms"] == 1, "frame 10 is after the lies, which do not last in this test"


def test_a_liar_that_is_never_suspended_is_censored_at_the_end_of_the_run() -> None:
    agent, _ = summarised([TRUSTED] * 20, lies=(4,))
    assert agent["suspended_after_s"] is None
    assert agent["observed_s"] == pytest.approx(1.5)


def test_a_suspension_before_the_first_lie_is_a_false_alarm_with_no_delay() -> None:
    agent, whole = summarised([TRUSTED] * 2 + [SUSPENDED] * 18, lies=(9,))
    assert (agent["suspended_after_s"], agent["observed_s"]) == (None, None)
    assert agent["suspensions"] == [
        {"from_s": pytest.approx(0.2), "until_s": None, "reason": "reason 2", "conduct": "honest"}
    ]
    assert whole["honest_suspended"] == ["a"]


def test_suspensions_of_faulty_and_lying_agents_are_no_false_alarms() -> None:
    states = [TRUSTED, SUSPENDED, TRUSTED, SUSPENDED, SUSPENDED, TRUSTED]
    agent, whole = summarised(states, lies=(3,), faults=(1,))
    assert [each["conduct"] for each in agent["suspensions"]] == ["faulty", "lying"]
    assert [each["until_s"] for each in agent["suspensions"]] == pytest.approx([0.2, 0.5])
    assert (agent["false_alarms"], agent["fault_alarms"], whole["false_alarms"]) == (0, 1, 0)


def test_a_lie_of_a_faulty_agent_counts_as_a_lie() -> None:
    agent, _ = summarised([TRUSTED] * 4, lies=(1, 2), faults=(0, 1))
    assert {name: sum(seconds.values()) for name, seconds in agent["seconds"].items()} == {
        "honest": pytest.approx(0.1),
        "faulty": pytest.approx(0.1),
        "lying": pytest.approx(0.2),
    }


def test_periods_of_an_undecided_agent_are_listed_and_are_neither_suspensions_nor_alarms() -> None:
    agent, whole = summarised([TRUSTED, UNDECIDED, UNDECIDED, SUSPENDED, UNDECIDED], lies=(4,))
    assert agent["undecided"] == [
        {"from_s": pytest.approx(0.1), "until_s": pytest.approx(0.3), "reason": "reason 1", "conduct": "honest"},
        {"from_s": pytest.approx(0.4), "until_s": None, "reason": "reason 4", "conduct": "lying"},
    ]
    assert [each["from_s"] for each in agent["suspensions"]] == pytest.approx([0.3])
    assert agent["false_alarms"] == whole["false_alarms"] == 1
    assert agent["suspended_after_s"] is None, "an undecided liar is not detected"
    assert agent["seconds"]["honest"]["undecided"] == pytest.approx(0.2)
    assert whole["seconds"]["lying"]["undecided"] == pytest.approx(0.1)


def test_what_agents_relay_is_judged_apart_and_the_relay_of_an_honest_agent_is_honest_if_deceived() -> None:
    """Agent a lies in frame 2; b relays a rumour in frame 4, and is honest."""
    names = ("a", "b", "a/relay", "b/relay")
    updates = [update(frame, dict.fromkeys(names, TRUSTED)) for frame in range(4)]
    updates += [update(frame, dict.fromkeys(names, TRUSTED) | {"b/relay": SUSPENDED}) for frame in (5, 6, 15)]
    updates += [update(9, dict.fromkeys(names, TRUSTED)), update(17, {"a/relay": SUSPENDED})]
    deceived = np.zeros((20, 2), bool)
    deceived[4, 1] = True
    frames, times_ns = np.arange(20), {frame: frame * 100_000_000 for frame in range(20)}
    updates.sort(key=lambda each: each.frame)
    part = integrity(updates, frames_of(2), {}, AGENTS, frames, times_ns, 0.1, 2.0, deceived)
    assert (part["honest_suspended"], part["false_alarms"]) == ([], 0)
    relays = part["relays"]
    assert (relays["honest_suspended"], relays["false_alarms"]) == (["b"], 2)
    periods = [
        [(e["from_s"], e["conduct"], e["deceived"]) for e in r["suspensions"]] for r in relays["agents"].values()
    ]
    assert periods == [[(1.7, "lying", False)], [(0.5, "honest", True), (1.5, "honest", True)]]
    short = integrity(updates, frames_of(2), {}, AGENTS, frames, times_ns, 0.1, 0.5, deceived)["relays"]["agents"]["b"]
    assert [each["deceived"] for each in short["suspensions"]] == [True, False]


def test_without_relays_nothing_is_said_about_them() -> None:
    assert "relays" not in integrity([update(0, {"a": TRUSTED})], frames_of(), {}, AGENTS, np.arange(20), {}, 0.1, 2.0)


def test_seconds_are_split_by_conduct_and_state() -> None:
    agent, whole = summarised([TRUSTED, SUSPENDED, SUSPENDED, FAULTY, FAULTY], lies=(1,), faults=(3,), last=1)
    assert agent["seconds"]["honest"]["trusted"] == pytest.approx(0.1)
    assert agent["seconds"]["lying"]["suspended"] == pytest.approx(0.2), "the lie lasts for one more frame"
    assert agent["seconds"]["faulty"]["faulty"] == pytest.approx(0.2)
    assert whole["seconds"]["honest"]["trusted"] == pytest.approx(0.6), "with those of the other agent"


def test_false_alarms_are_counted_per_hour_of_the_system() -> None:
    _, whole = summarised([TRUSTED, SUSPENDED, TRUSTED, SUSPENDED] + [TRUSTED] * 32)
    assert whole["false_alarms"] == 2
    assert whole["false_alarms_per_hour"] == pytest.approx(2 / (3.6 / 3600))


def test_suspicion_is_the_negative_of_the_log_odds() -> None:
    updates = [update(0, {"a": TRUSTED}, 2.0), update(1, {"a": TRUSTED}, -4.0)]
    nothing = np.zeros((3, 2), bool)
    whole = summary(
        TrustHistory.of(updates, AGENTS, np.arange(3)), Conduct(nothing, nothing), AGENTS, np.arange(3.0), 1.0, STATES
    )
    assert whole["agents"]["a"]["suspicion"] == {"max": 4.0, "mean": 1.0}
    assert whole["agents"]["b"]["suspicion"] == {"max": None, "mean": None}


def test_a_suspension_with_the_first_lie_or_after_an_earlier_one_has_ended_is_a_detection() -> None:
    with_it, _ = summarised([TRUSTED] * 4 + [SUSPENDED] * 4, lies=(4,))
    assert with_it["suspended_after_s"] == 0.0
    again, _ = summarised([SUSPENDED] * 4 + [TRUSTED] * 2 + [SUSPENDED] * 2, lies=(4,))
    assert again["suspended_after_s"] == pytest.approx(0.2)


def test_tables_have_a_row_for_each_agent_and_object() -> None:
    updates = [update(0, {"a": TRUSTED, "b": SUSPENDED}, objects=2), update(1, {"b": FAULTY}, objects=1)]
    times_ns = {0: 0, 1: 100_000_000}
    agents = agent_table(updates, times_ns, STATES)
    assert agents["frame"].tolist() == [0, 0, 1]
    assert agents["agent"].tolist() == ["a", "b", "b"]
    assert agents["state"].tolist() == ["trusted", "suspended", "faulty"]
    assert agents["reason"].tolist() == ["", "reason 0", ""]
    objects = object_table(updates, times_ns)
    assert objects["frame"].tolist() == [0, 0, 1]
    assert objects["time_s"].tolist() == pytest.approx([0.0, 0.0, 0.1])
    assert objects["withheld"].all()


def test_roc_counts_alarms_at_each_threshold() -> None:
    curve = roc([5.0, 4.0, 4.0, 1.0], [True, False, True, False])
    assert curve.threshold.tolist() == [np.inf, 5.0, 4.0, 1.0]
    assert curve.true_positives.tolist() == [0, 1, 2, 2]
    assert curve.false_positives.tolist() == [0, 0, 1, 2]
    assert (curve.liars, curve.honest) == (2, 2)


@pytest.mark.parametrize(
    ("scores", "labels", "area"),
    [
        ([3, 1, 2, 0], [1, 1, 0, 0], 0.75),
        ([np.nan, 2, 1, np.nan], [1, 1, 0, 0], 0.625),
    ],
)
def test_area_is_how_often_a_liar_scores_above_an_honest_agent(scores, labels, area):
    assert auc(scores, labels) == pytest.approx(area)


def test_area_of_random_scores_equals_a_comparison_of_all_pairs() -> None:
    random = np.random.default_rng(4)
    scores, labels = random.integers(0, 20, 200).astype(float), random.random(200) < 0.3
    above = scores[labels][:, None] - scores[~labels][None, :]
    assert auc(scores, labels) == pytest.approx(((above > 0) + 0.5 * (above == 0)).mean())


def test_area_is_undefined_without_both_kinds() -> None:
    assert np.isnan(auc([1.0, 2.0], [True, True]))
    assert np.isnan(auc([1.0, 2.0], [False, False]))
    assert np.isnan(partial_auc([1.0], [False], 1.0, 1.0))


def test_partial_area_is_the_mean_share_detected_below_a_rate() -> None:
    """Without an alarm half the liars are found; at one alarm in two hours, all."""
    scores, labels = [9.0, 5.0, 3.0, 1.0], [True, False, True, False]
    assert partial_auc(scores, labels, hours=2.0, max_rate_per_hour=0.5) == pytest.approx(0.5)
    assert partial_auc(scores, labels, hours=2.0, max_rate_per_hour=1.0) == pytest.approx(0.75)
    assert partial_auc(scores, labels, hours=0.1, max_rate_per_hour=1.0) == pytest.approx(0.5)


def test_wrong_lengths_and_rates_are_refused() -> None:
    with pytest.raises(ValueError, match=r"labels.*1.*2"):
        roc([1.0, 2.0], [True])
    with pytest.raises(ValueError, match="more than 0"):
        partial_auc([1.0], [True], 0.0, 1.0)
