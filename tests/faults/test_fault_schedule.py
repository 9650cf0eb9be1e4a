"""Random schedules depend on a seed, are consistent, and end before the run."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.config import registry
from mast_zenoh.faults import Fault, plan, random_schedule

AGENTS = ("ego", "infra_1", "infra_2")
SERVERS = ("broker", "command_center")
ROLES = {"simulator": "simulator", **dict.fromkeys(AGENTS, "agent"), **{name: name for name in SERVERS}}
KINDS = {
    name
    for name in registry.known_types(Fault)
    if name != "Impair" and registry.known_types(Fault)[name].__module__.startswith("mast_zenoh.")
}


@given(st.integers(0, 2**31), st.floats(2.0, 20.0), st.integers(1, 12), st.booleans())
def test_every_schedule_is_feasible_and_heals_in_time(seed, duration_s, max_faults, lockstep) -> None:
    specs = random_schedule(seed, duration_s, AGENTS, servers=SERVERS, settle_s=1.0, max_faults=max_faults)
    assert 1 <= len(specs) <= max_faults
    times_ns = np.arange(round(duration_s * 10)) * 100_000_000
    faults = [("", registry.build(spec, Fault, f"faults[{i}]")) for i, spec in enumerate(specs)]
    fault_plan = plan(faults, ROLES, times_ns, seed, lockstep=lockstep)
    assert not fault_plan.missed
    assert all(fault.over is not None and fault.over <= duration_s - 1.0 + 1e-9 for _, fault in faults)
    up = dict.fromkeys(ROLES, True)
    for step in fault_plan.steps:
        up[step.node] = step.action in ("start", "resume")
    assert all(up.values()), "all agents are present at the end"


def test_equal_seeds_give_equal_schedules_and_different_seeds_give_different_ones() -> None:
    assert random_schedule(3, 6.0, AGENTS) == random_schedule(3, 6.0, AGENTS)
    assert len({str(random_schedule(seed, 6.0, AGENTS)) for seed in range(50)}) == 50


def test_every_kind_of_fault_occurs() -> None:
    specs = [spec for seed in range(300) for spec in random_schedule(seed, 6.0, AGENTS, servers=SERVERS)]
    left_out = {"Unplug", "BlindSector", "GhostDetections"}
    assert {spec["type"] for spec in specs} == KINDS - left_out, "only compose disconnects nodes; sensors are intact"
    assert {spec.get("node") for spec in specs} >= {*AGENTS, *SERVERS}
    assert {spec["nodes"] for spec in specs if isinstance(spec.get("nodes"), str)} == {
        *("one", "minority", "majority", "agent")
    }


def test_kinds_can_be_chosen() -> None:
    specs = [spec for seed in range(20) for spec in random_schedule(seed, 6.0, AGENTS, kinds=["Loss", "Kill"])]
    assert {spec["type"] for spec in specs} == {"Loss", "Kill"}


def test_only_the_configured_servers_are_targets() -> None:
    specs = [spec for seed in range(100) for spec in random_schedule(seed, 6.0, AGENTS)]
    assert {spec["node"] for spec in specs if "node" in spec} == set(AGENTS)


def test_a_run_that_is_too_short_is_refused() -> None:
    with pytest.raises(ValueError, match=r"duration_s.*2.0.*2.25"):
        random_schedule(0, 2.0, AGENTS)
    with pytest.raises(ValueError, match=r"fault 'Los'.*'Loss'"):
        random_schedule(0, 6.0, AGENTS, kinds=["Los"])
