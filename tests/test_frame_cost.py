"""No role of a frame costs more than its budget; if one does, the functions that grew are named."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh.config import loading

pytestmark = pytest.mark.long

cost = loading.module(Path(__file__).parents[1] / "benchmarks" / "cost.py")


def require_comparable(*, instructions: bool) -> None:
    """Skip if costs are not those of the budgets' machine."""
    if reason := cost.why_not(instructions=instructions):
        pytest.skip(reason)


def assert_within_budgets(costs: dict[str, dict]) -> None:
    """Fail with a line for each excess."""
    if excesses := cost.excesses(costs, cost.load()):
        pytest.fail("\n".join(excesses), pytrace=False)


@pytest.mark.heavy
def test_calls_bytes_and_messages_of_a_frame_are_within_their_budgets() -> None:
    require_comparable(instructions=False)
    assert_within_budgets(cost.measure(instructions=False))


@pytest.mark.heavy
@pytest.mark.timeout(1800)
def test_instructions_of_a_frame_are_within_their_budgets() -> None:
    """Of the richest run: other runs warm up its code too little. Budgets of calls and bytes are compared in all."""
    require_comparable(instructions=True)
    assert_within_budgets(cost.measure(instructions=True, runs=["defended"]))


def test_an_excess_names_the_functions_that_grew() -> None:
    budgets = {"baseline": {"agent": {"calls": {"total": 100.0, "track": 90.0, "publish": 10.0}}}}
    within = {"baseline": {"agent": {"calls": {"total": 102.0, "track": 92.0, "publish": 10.0}}}}
    above = {"baseline": {"agent": {"calls": {"total": 105.0, "track": 92.0, "publish": 8.0, "estimate": 5.0}}}}
    assert cost.excesses(within, budgets) == []
    assert cost.excesses(above, budgets) == ["baseline, agent: 105.0 calls a frame (+5.0%): estimate +5.0, track +2.0"]


def test_a_role_without_a_budget_is_an_excess() -> None:
    (line,) = cost.excesses({"baseline": {"link": {"messages": {"total": 4.0, "tracks": 4.0}}}}, {})
    assert line == "baseline, link: 4.0 messages a frame (no budget): tracks +4.0"


def test_functions_that_were_too_cheap_to_keep_have_grown_by_what_exceeds_the_cheapest_kept() -> None:
    before = {"total": 900.0} | {f"function_{i}": 10.0 + i for i in range(cost.TOP)}
    assert cost.growth(before | {"other": 9.0, "new": 14.0}, before) == ["new +4.0"]


def test_calls_and_bytes_are_those_within_each_function() -> None:
    def outer(depth: int) -> None:
        inner()
        if depth:
            outer(depth - 1)

    def inner() -> bytearray:
        return bytearray(100_000)

    with cost.Tally() as tally:
        outer(2)
    costs = tally.costs()
    names = {function: f"{__name__}.{function.__qualname__}" for function in (outer, inner)}
    assert (costs["calls"][names[outer]], costs["calls"][names[inner]]) == (6, 3)
    assert 300_000 < costs["bytes"][names[inner]] < costs["bytes"][names[outer]] < 310_000
    assert costs["bytes"]["total"] < 320_000


def test_instructions_are_those_of_each_function_without_those_that_it_calls(tmp_path: Path) -> None:
    dump = tmp_path / "out.1"
    dump.write_text(
        "version: 1\nevents: Ir\nob=/lib/kernels.so\nfl=a.c\nfn=__pyx_pf_10mast_zenoh_7kernels_5pairs_4pair_gains\n"
        "10 20\n11 5\ncfn=memcpy\ncalls=2 30\n11 1000\n12 1\nfn=list_dealloc'2\n1 7\nob=/lib/libblas.so.3\n"
        "fn=0x0000000000012340\n0 4\nfn=0x0000000000056780\n0 4\ntotals: 41\n"
    )
    assert cost.by_function(dump) == {"total": 41, "kernels.pairs.pair_gains": 26, "list_dealloc": 7, "libblas": 8}


def test_the_budgets_are_of_this_python_and_these_roles() -> None:
    budgets = cost.load()
    assert budgets["versions"].keys() == cost.versions().keys()
    assert budgets.keys() == {"versions", *cost.RUNS}
    for run in cost.RUNS:
        assert budgets[run].keys() >= {"simulator", "agent", "broker", "command_center", "evaluator", "recorder"}
