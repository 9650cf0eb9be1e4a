"""Effects of each link rule, alone and combined, and refused parameters."""

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_bench import PERIOD_NS, arrived, build, carry, chain, delays, sensed
from link_rules import RULES

from mast_zenoh import links
from mast_zenoh.arrays.geometry import heading, rotation_from_quaternion
from mast_zenoh.config.registry import known_types
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.links import FATES, PROFILES, Passage, PassageOutcome, Rule, displaced, flipped, profile


def outcome_of(*rules: dict[str, Any], at_s: float = 0.0, **message: Any) -> PassageOutcome:
    """The outcome of one message."""
    time_ns = round(at_s * 1e9)
    return chain(rules).carry(Passage(time_ns, time_ns, **message))


def test_every_rule_is_tested_and_declares_its_fate() -> None:
    shipped = {name for name, rule in known_types(Rule).items() if rule.__module__.startswith("mast_zenoh.")}
    assert shipped == RULES.keys()
    assert all(build(type=name, **parameters).fate in FATES for name, parameters in RULES.items())


@pytest.mark.parametrize("name", RULES)
def test_a_rule_acts_from_its_start_and_no_longer_at_its_end(name: str) -> None:
    parameters = RULES[name] | dict(probability=1.0) if "probability" in RULES[name] else RULES[name]
    if name == "GilbertElliott":
        parameters = dict(good_to_bad=1.0, bad_to_good=0.0)
    rule = dict(type=name, **(parameters | dict(at=1.0, until=2.0)))
    far = dict(size=1000, position=np.array([90.0, 0.0, 0.0]), referenced=True, sensed=sensed((30.0, 0.0)))
    for at_s, acts in ((0.9, False), (1.0, True), (1.9, True), (2.0, False)):
        outcome = outcome_of(rule, at_s=at_s, **far)
        plain = Passage(round(at_s * 1e9), round(at_s * 1e9), **far)
        untouched = len(outcome.leaving) == 1 and outcome.leaving[0][0].sensed is plain.sensed
        arrays = dict(position=None, sensed=None)
        untouched = untouched and outcome.leaving[0][0]._replace(**arrays) == plain._replace(**arrays)
        assert untouched is not acts, at_s
        assert bool(outcome.fates) is acts


def test_a_drop_is_attributed_to_the_first_rule_that_drops() -> None:
    assert outcome_of(dict(type="Loss", probability=0.0), dict(type="Cut"), dict(type="Cut")).fates == {"dropped": 1}
    passed = outcome_of()
    assert ([after_s for _, after_s in passed.leaving], passed.fates) == ([0.0], {}), "without rules"


def test_a_message_is_not_dropped_if_a_copy_arrives() -> None:
    rules = [dict(type="Duplicate", probability=1.0, copies=3), dict(type="Loss", probability=0.6)]
    for outcome in carry(rules, 200):
        assert ("dropped" in outcome.fates) is not bool(outcome.leaving)


def test_delays_add_up_and_the_rule_with_the_longest_delay_is_named() -> None:
    rules = [dict(type="Delay", mean_s=s, distribution="constant") for s in (0.05, 0.3, 0.1)]
    outcome = outcome_of(*rules)
    assert outcome.delay_s == pytest.approx(0.45)
    assert outcome.fates == {"delayed": 1}


def test_a_message_does_not_overtake_its_predecessor() -> None:
    rules = [dict(type="Delay", mean_s=0.5, distribution="constant", until=0.05)]
    first, second, *_, last = carry(rules, 10)
    assert first.delay_s == pytest.approx(0.5)
    assert second.delay_s == pytest.approx(0.4)
    assert second.fates == {"delayed": 0}
    assert last.delay_s == 0.0


def test_a_reordered_message_is_overtaken_and_delays_no_other() -> None:
    wire = chain([dict(type="Reorder", probability=1.0, by_s=0.35, until=0.05)])
    departures = [i * 0.1 + wire.carry(Passage(i * PERIOD_NS, i * PERIOD_NS)).delay_s for i in range(5)]
    assert departures == pytest.approx([0.35, 0.1, 0.2, 0.3, 0.4])


@given(names=st.lists(st.sampled_from([n for n in RULES if n != "Reorder"]), max_size=5), seed=st.integers(0, 20))
def test_without_reordering_messages_leave_in_order_of_arrival(names: list[str], seed: int) -> None:
    rules = [dict(type=name, **RULES[name]) for name in names]
    outcomes = carry(rules, 30, seed=seed, size=5000, position=np.zeros(3), referenced=True)
    departures = [i * PERIOD_NS + round(s * 1e9) for i, outcome in enumerate(outcomes) for _, s in outcome.leaving]
    assert departures == sorted(departures)
    assert min(delays(outcomes), default=0.0) >= 0.0


def test_held_messages_are_delivered_in_order_at_the_end() -> None:
    outcomes = carry([dict(type="Hold", at=0.2, until=0.55)], 8)
    departures = [i * 0.1 + outcome.delay_s for i, outcome in enumerate(outcomes)]
    assert departures == pytest.approx([0.0, 0.1, 0.55, 0.55, 0.55, 0.55, 0.6, 0.7])


@pytest.mark.parametrize(("x", "arrives"), [(0.0, True), (49.0, True), (51.0, False), (160.0, True), (1e6, False)])
def test_messages_out_of_range_of_every_gateway_are_dropped(x: float, arrives: bool) -> None:
    rule = dict(type="RangeLimit", range_m=50.0, gateways=[[0.0, 0.0, 0.0], [200.0, 0.0, 5.0]])
    assert bool(outcome_of(rule, position=np.array([x, 0.0, 0.0])).leaving) is arrives
    assert outcome_of(rule).leaving, "no message is dropped while the position is unknown"


def test_clock_drift_increases_the_offset_over_time() -> None:
    rule = dict(type="ClockSkew", offset_s=-0.2, drift=0.1, at=1.0)
    ahead = [outcome_of(rule, at_s=at_s).leaving[0][0].skew_ns for at_s in (0.0, 1.0, 3.0)]
    assert ahead == [0, -200_000_000, 0]
    assert outcome_of(rule, rule, at_s=1.0).leaving[0][0].skew_ns == -400_000_000


def test_a_pose_error_leaves_messages_without_a_frame_of_reference_unchanged() -> None:
    outcome = outcome_of(dict(type="PoseError", bias_m=[1.0, 0.0]), referenced=False)
    assert outcome.fates == {}
    assert outcome.leaving[0][0].shift == (0.0, 0.0)


def test_a_pose_error_moves_and_rotates_the_frame_of_reference_about_the_vertical() -> None:
    half = math.sqrt(0.5)
    body = {"origin": np.array([5.0, 6.0, 7.0]), "rotation": np.array([half, 0.0, 0.0, half]), "id": np.arange(3)}
    displaced_body = displaced(body, (1.0, -1.0), 0.25)
    assert displaced_body["origin"].tolist() == [6.0, 5.0, 7.0]
    assert heading(rotation_from_quaternion(displaced_body["rotation"])) == pytest.approx(math.pi / 2 + 0.25)
    assert displaced_body["id"] is body["id"]


@given(payload=st.binary(max_size=50), positions=st.lists(st.floats(0.0, 1.0), max_size=8))
def test_the_configured_number_of_bits_is_flipped_reversibly(payload: bytes, positions: list[float]) -> None:
    once = flipped(payload, positions)
    assert len(once) == len(payload)
    assert flipped(once, positions) == payload
    differing = sum((a ^ b).bit_count() for a, b in zip(payload, once, strict=True))
    assert differing <= len(positions)
    if payload and len(positions) == 1:
        assert differing == 1


def test_copies_are_numbered_and_have_independent_random_numbers() -> None:
    rules = [dict(type="Flood", copies=4), dict(type="Delay", mean_s=0.05, jitter_s=0.02), dict(type="Flood", copies=1)]
    outcome = outcome_of(*rules)
    copies = [passage.copy for passage, _ in outcome.leaving]
    assert sorted(copies) == list(range(10))
    assert len({passage.delay_ns for passage, _ in outcome.leaving}) == 5
    assert outcome.fates["duplicated"] == 0


def test_the_number_of_copies_is_limited() -> None:
    assert len(outcome_of(*[dict(type="Flood", copies=100)] * 3).leaving) <= 1001


@pytest.mark.parametrize("name", ["Loss", "GilbertElliott", "Duplicate", "Corrupt", "Reorder"])
@pytest.mark.parametrize("other", ["Cut", "Delay", "Flood", "Loss"])
def test_adding_a_rule_changes_no_random_draw_of_another(name: str, other: str) -> None:
    rule = dict(type=name, **RULES[name])
    added = dict(type=other) | RULES[other] | dict(at=1.0, until=3.0)
    alone = carry([rule], 600)
    kept = [i for i in range(600) if not 10 <= i < 30]
    for rules in ([rule, added], [added, rule]) if name != other else ([rule, added],):
        mixed = carry(rules, 600)
        for i in kept:
            (before, _), (after, _) = (o.leaving[0] if o.leaving else (None, None) for o in (alone[i], mixed[i]))
            assert (before is None) == (after is None)
            assert before is None or (before.flips, before.overtakes) == (after.flips, after.overtakes)
            assert len(alone[i].leaving) == len(mixed[i].leaving)


@pytest.mark.parametrize("name", RULES)
def test_a_rule_depends_only_on_seed_and_wire(name: str) -> None:
    rules = [dict(type=name, **RULES[name]), dict(type="Delay", mean_s=0.1, jitter_s=0.1)]
    first, repeated, other = (carry(rules, 300, seed=seed, size=900, referenced=True) for seed in (3, 3, 4))
    assert first == repeated
    assert name == "Cut" or first != other


def test_rules_on_two_wires_do_not_share_state() -> None:
    rule = build(type="Bandwidth", bits_per_s=1000.0, queue_s=0.0)
    one, two = (links.Chain([rule], lambda *purpose: np.random.default_rng(0)) for _ in range(2))
    assert one.carry(Passage(0, 0, size=100)).leaving
    assert not one.carry(Passage(0, 0, size=100)).leaving, "its queue is full"
    assert two.carry(Passage(0, 0, size=100)).leaving


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("name", "parameter", "values"),
    [
        *((name, "probability", (-0.1, 1.1, NAN)) for name in ("Loss", "Duplicate", "Corrupt", "Reorder")),
        *(("GilbertElliott", key, (2.0,)) for key in ("good_to_bad", "bad_to_good", "loss_good", "loss_bad")),
        ("Delay", "mean_s", (-1.0, 0.0, NAN, INF, 1e9)),
        ("Delay", "jitter_s", (-1.0, NAN, INF)),
        ("Delay", "distribution", ("poisson",)),
        ("Bandwidth", "bits_per_s", (0.0, -1.0, NAN, INF)),
        ("Bandwidth", "queue_s", (-1.0, NAN)),
        ("Reorder", "by_s", (-0.1,)),
        ("Duplicate", "copies", (0,)),
        ("Flood", "copies", (10**6,)),
        ("Corrupt", "flips", (0,)),
        ("RangeLimit", "range_m", (0.0, -1.0, NAN)),
        ("RangeLimit", "gateways", ([], [[0.0, 1.0]], [[NAN, 0.0, 0.0]])),
        ("ClockSkew", "offset_s", (NAN,)),
        ("ClockSkew", "drift", (2.0,)),
        ("PoseError", "position_std_m", (-1.0,)),
        ("PoseError", "bias_m", ([NAN, 0.0],)),
        ("Hold", "until", (None,)),
        ("Cut", "at", (-1.0, NAN)),
        ("Cut", "until", (0.0, NAN)),
    ],
)
def test_invalid_rule_parameters_are_refused_by_name(name: str, parameter: str, values: tuple[Any, ...]) -> None:
    for value in values:
        with pytest.raises(ConfigurationError) as caught:
            build(type=name, **(RULES[name] | {parameter: value}))
        prefixes = [f"link.rules_up[0]{separator}{parameter}" for separator in (".", f": {name}: ")]
        assert str(caught.value).startswith(tuple(prefixes)), value


def test_jitter_of_a_constant_delay_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=re.escape("link.rules_up[0]: Delay: jitter_s")):
        build(type="Delay", mean_s=0.12, jitter_s=0.05, distribution="constant")


def test_a_profile_is_a_copy_of_valid_rules() -> None:
    for name in PROFILES:
        for rules in profile(name).values():
            for rule in rules:
                build(**(rule | (dict(gateways=[[0.0, 0.0, 0.0]]) if rule["type"] == "RangeLimit" else {})))
    profile("wired")["up"].clear()
    assert profile("wired")["up"]
    assert profile("wired").keys() == {"up", "down"}
    with pytest.raises(ConfigurationError, match=r"profile 'wirelss_v2x'.*'wireless_v2x'"):
        profile("wirelss_v2x")


def test_a_wireless_link_loses_more_and_is_slower_than_a_wired_one() -> None:
    lost, late = {}, {}
    for name in ("wired", "wireless_v2x"):
        rules = [rule for rule in profile(name)["up"] if rule["type"] != "RangeLimit"]
        outcomes = carry(rules, 2000, size=5000)
        lost[name], late[name] = 1.0 - arrived(outcomes).mean(), delays(outcomes).mean()
    assert lost["wired"] < 0.001 < 0.03 < lost["wireless_v2x"] < 0.1
    assert late["wired"] < 0.005 < 0.02 < late["wireless_v2x"] < 0.05
