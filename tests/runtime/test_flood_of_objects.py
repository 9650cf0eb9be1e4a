"""A flood of thousands of objects from one agent costs no object that was there before, and is told."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec

FRAMES, BEGIN, ROWS = 22, 12, 6000
ON_TRACKS = 'keyexpr.rewrites=["on_tracks.toml"]'
#: Scenarios, the key of the picture, and who counts.
RUNS = {
    "centre": ("uncoordinated", ["n_adversaries=1", 'compromised=["infra_4"]', ON_TRACKS], "cc/picture", "broker"),
    "two centres": ("two_centres", ["n_adversaries=1"], "cc/picture", "west"),
    "peers": ("peers", ["n_adversaries=1"], "agent/ego/picture", "peer_ego"),
}


def resolved(run: str, attack: dict[str, Any], **options: Any) -> Resolved:
    """A run with one adversary on the tracks of an agent."""
    name, sets, _, _ = RUNS[run]
    path, loaded = scenario.load(name, sets)
    (adversary,) = loaded["adversaries"].values()
    adversary["attack"] = attack
    return scenario.resolve(path, loaded, frames=FRAMES, **options)


def flood(rows: int = ROWS) -> dict[str, Any]:
    return dict(type="Flood", rows=rows, start_s=0.1 * BEGIN)


def played(run: Resolved, **options: Any) -> tuple[list[Outgoing], dict[str, Any], InProcess]:
    messages: list[Outgoing] = []
    process = InProcess(run, tap=messages.append, **options)
    returned = process.run()
    assert process.failures() == {}
    return messages, returned, process


def seen(messages: list[Outgoing], picture: str) -> dict[int, set[int]]:
    """Ids of the true objects within 2 m of an object of the picture, paired by least total distance, by frame."""
    bodies = {
        name: {m.payload.header.frame: m.payload.body for m in messages if m.key.endswith(name)}
        for name in ("scene/truth", picture)
    }
    ids: dict[int, set[int]] = {}
    for frame, body in bodies[picture].items():
        truth = bodies["scene/truth"][frame]
        apart = np.linalg.norm(truth["position"][:, None, :2] - body["position"][None, :, :2], axis=2)
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0))
        ids[frame] = set(truth["id"][rows[apart[rows, columns] < 2.0]].tolist())
    return ids


def most_rows(messages: list[Outgoing]) -> int:
    return max((len(m.payload.body["id"]) for m in messages if m.key == "cc/collated"), default=0)


@pytest.mark.parametrize("run", RUNS)
def test_a_flood_costs_no_object_that_was_there_before_and_is_told(run: str) -> None:
    _, _, picture, counter = RUNS[run]
    unattacked, attacked = resolved(run, dict(type="PassThrough")), resolved(run, flood())
    messages, _, _ = played(unattacked)
    before, rows = seen(messages, picture), most_rows(messages)
    messages, returned, process = played(attacked)
    assert most_rows(messages) <= rows + 15, "at the centre, few more than the agent had"
    after = seen(messages, picture)
    there = before[BEGIN - 1]
    assert len(there) > 10
    for frame in range(BEGIN, FRAMES):
        assert there & before[frame] <= after[frame], frame
    flooded = FRAMES - BEGIN
    (victim,) = attacked.nodes["adversary_1"].agents
    left_out = results.left_out(returned)
    assert left_out.keys() == {victim}
    assert left_out[victim] >= (ROWS - 100) * (flooded - 1)
    assert sum(n for (_, kind), n in process.hosts[counter].rejected.items() if kind == "rows") >= flooded - 1


@pytest.mark.heavy
@pytest.mark.parametrize(
    "sets",
    [
        ["scene_index=9", "n_infrastructure=1", "n_mobile=7", "codec=cpm", "rules=CpmGeneration", "awareness=true"],
        ["scene_index=8", "n_infrastructure=1", "n_mobile=6", "codec=cpm", "awareness=true"],
    ],
)
def test_of_many_honest_peers_all_tracks_are_fused(sets: list[str]) -> None:
    _, returned, _ = played(scenario.resolve(*scenario.load("peers", sets), frames=60))
    assert results.left_out(returned) == {}


@pytest.mark.heavy
@pytest.mark.parametrize("run", RUNS)
def test_which_rows_of_a_flood_are_used_does_not_depend_on_the_order_of_delivery_or_on_encoding(run: str) -> None:
    picture = RUNS[run][2]
    pictures = [
        [
            m.payload if isinstance(m.payload, bytes) else codec.encode(m.payload)
            for m in played(resolved(run, flood(2000)), **options)[0]
            if m.key.endswith(picture)
        ]
        for options in ({}, {"shuffle": 1}, {"encode": True})
    ]
    assert pictures[0] == pictures[1] == pictures[2]


def test_without_a_limit_the_rows_of_a_flood_are_those_of_the_highest_scores() -> None:
    run = resolved("centre", flood())
    unlimited = replace(run, nodes=dict(run.nodes))
    unlimited.nodes["broker"].config["input_limit"] = dict(type="NoInputLimit")
    messages, returned, _ = played(unlimited)
    assert results.left_out(returned) == {"infra_4": (ROWS - run.max_rows["tracks"]) * (FRAMES - BEGIN)}
    assert most_rows(messages) > run.max_rows["tracks"]
