"""Measures how often errors are attributed wrongly, against paired twins of the same scene and seed.

    .venv/bin/python tools/wrong_blame.py [--scenes SCENE ...] [--seeds SEED ...] [--frames N] [--cells NAME ...]

Each cell is a pair of runs that differ in one thing: an attack, a fault or a defence. An error of the first run (of the
pictures of all agents) exists in the second one too if the same object is missed there in the same frame, or if a false
track is within 2 m, in this frame or at most two frames away (each for one). It prints for each cell and kind of error:

    present   errors that exist in the twin too, and the share of them that is blamed on what the twin lacks
    new       errors that do not, and the share of them that is blamed on it
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mast_zenoh import scenario
from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import Bools
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.metrics.assignment import Places, centre_distance, pairs_within
from mast_zenoh.metrics.causes import ATTACK_CAUSES, FAULT_CAUSES
from mast_zenoh.scenario import agents_of

GATE_M, WINDOW = 2.0, 2
AT_S = 4.0
SCENES = ("intersection:0", "intersection:1", "intersection:2")
BLAMED = {"attack": ATTACK_CAUSES, "fault": FAULT_CAUSES, "defence": ("withheld",)}

UNDEFENDED: dict[str, Any] = {"attack_start_s": AT_S}
#: By name: what the twin lacks, the scenario, its values, and those of the twin.
ATTACKS: dict[str, tuple[str, dict[str, Any]]] = {
    "uncoordinated": ("uncoordinated", UNDEFENDED),
    "single": ("uncoordinated", UNDEFENDED | {"n_adversaries": 1}),
    "coordinated": ("coordinated", UNDEFENDED),
    "hide": ("hide_object", UNDEFENDED),
}
STAGES = ("FaultOrLie", "FreeSpace", "KOfN", "Mate", "SequentialConsistency")
SENSORS = ["infra_1", "infra_2", "infra_3", "infra_4"]
#: By name, a fault of the first two agents that are not the ego, unless it names others.
FAULTS: dict[str, dict[str, Any]] = {
    "skew .1 s": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": 0.1}},
    "skew .4 s": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": 0.4}},
    "skew -.4 s": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": -0.4}},
    "blind": {"type": "BlindSector", "azimuth_min_deg": -60.0, "azimuth_max_deg": 60.0},
    "pose": {"type": "Impair", "rule": {"type": "PoseError", "bias_m": (0.7, 0.4), "bias_yaw_rad": 0.01}},
    "loss": {"type": "BurstLoss", "good_to_bad": 0.1, "bad_to_good": 0.3},
    "delay": {"type": "Delay", "mean_s": 0.3, "jitter_s": 0.05},
    "cut off: partition": {"type": "Partition", "until": AT_S + 3.0},
    "cut off: killed": {"type": "Kill", "restart_after": 3.0},
    "cut off: loss": {"type": "Loss", "probability": 0.5, "until": AT_S + 6.0, "nodes": SENSORS},
    "cut off: delay .25 s": {"type": "Delay", "mean_s": 0.25, "until": AT_S + 3.0, "nodes": SENSORS},
    "cut off: delay 1 s": {"type": "Delay", "mean_s": 1.0, "until": AT_S + 3.0, "nodes": SENSORS},
}


@dataclass(frozen=True)
class Cell:
    """A pair of scenarios; lacks: what the second one lacks: "attack", "fault" or "defence"."""

    name: str
    lacks: str
    first: tuple[str, dict[str, Any], dict[str, Any] | None]
    twin: tuple[str, dict[str, Any], dict[str, Any] | None]


def cells() -> list[Cell]:
    """All cells: attacks without and with each defence, defences without an attack, and faults."""
    result = []
    for name, (file, values) in ATTACKS.items():
        result.append(Cell(name, "attack", (file, values, None), ("baseline", {}, None)))
    for stage in STAGES:
        defended: dict[str, Any] = {"defence": stage, "attack_start_s": AT_S}
        first, trusting = ("defended", defended, None), ("defended", defended | {"defence": "NoIntegrity"}, None)
        quiet = ("defended", defended | {"n_adversaries": 0}, None)
        result.append(Cell(f"coordinated, {stage}", "attack", first, quiet))
        result.append(Cell(f"coordinated, {stage}", "defence", first, trusting))
        nobody = ("defended", defended | {"defence": "NoIntegrity", "n_adversaries": 0}, None)
        result.append(Cell(f"no attack, {stage}", "defence", quiet, nobody))
    for name, fault in FAULTS.items():
        result.append(Cell(name, "fault", ("baseline", {}, fault), ("baseline", {}, None)))
    return result


def objects(side: tuple[str, dict[str, Any], dict[str, Any] | None], where: Where) -> Mapping[str, Any]:
    """The objects table of a run."""
    name, values, fault = side
    path, content = scenario.load_values(name, values | {"scene": where.scene}, [])
    if fault is not None:
        nodes = [agent for agent in agents_of(content["scene"]) if agent != "ego"][:2]
        content = content | {"faults": [{"at": AT_S, "nodes": nodes} | fault]}
    resolved = scenario.resolve(path, content, seed=where.seed, frames=where.frames)
    process = InProcess(resolved)
    process.run()
    node = next(host.node for host in process.hosts.values() if host.node.role == "evaluator")
    table: Mapping[str, Any] = node.scoring.results()["tables"]["objects"]
    return table


@dataclass(frozen=True)
class Where:
    """A scene (a short name, or a dict), a seed, and the number of frames."""

    scene: str | dict[str, Any]
    seed: int
    frames: int


def errors(table: Mapping[str, Any], outcome: str) -> dict[str, Any]:
    """The errors of the pictures of all agents."""
    rows = (table["estimator"] == "picture") & (table["outcome"] == outcome)
    return {name: column[rows] for name, column in table.items()}


def in_twin(one: Mapping[str, Any], twin: Mapping[str, Any], outcome: str) -> Bools:
    """Which errors also exist in the twin."""
    if outcome == "missed":
        theirs = set(zip(twin["agent"], twin["frame"].tolist(), twin["id"].tolist(), strict=True))
        ours = zip(one["agent"], one["frame"].tolist(), one["id"].tolist(), strict=True)
        return np.array([each in theirs for each in ours], bool)
    names = np.unique(np.concatenate([one["agent"], twin["agent"]]))
    position = [np.column_stack([table[axis] for axis in "xyz"]).astype(float) for table in (one, twin)]
    group = [np.searchsorted(names, table["agent"]) * 1_000_000 + table["frame"] for table in (one, twin)]
    result, taken = np.zeros(len(group[0]), bool), np.zeros(len(group[1]), bool)
    for shift in sorted(range(-WINDOW, WINDOW + 1), key=abs):  # each error of the twin stands for one of this run
        ours, theirs = np.flatnonzero(~result), np.flatnonzero(~taken)
        places = [Places(group[0][ours], position[0][ours]), Places(group[1][theirs] + shift, position[1][theirs])]
        i, j = pairs_within(*places, GATE_M)
        pairs = greedy_matching(i, j, centre_distance(places[0].position[i], places[1].position[j]))
        result[ours[i[pairs]]] = taken[theirs[j[pairs]]] = True
    return result


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--frames", type=int, default=130)
    parser.add_argument("--cells", nargs="+", default=[])
    parser.add_argument("--causes", action="store_true", help="print the causes of both sorts of errors")
    options = parser.parse_args(arguments)
    print(f"{'cell':32} {'twin lacks':10} {'error':6} {'present':>8} {'blamed':>7} {'new':>8} {'blamed':>7}")
    for cell in cells():
        if options.cells and not any(name in cell.name for name in options.cells):
            continue
        counts: dict[str, Counter[tuple[bool, str]]] = {"false": Counter(), "missed": Counter()}
        for scene in options.scenes:
            for seed in options.seeds:
                where = Where(scene, seed, options.frames)
                tables = [objects(side, where) for side in (cell.first, cell.twin)]
                for outcome, counter in counts.items():
                    one, other = (errors(table, outcome) for table in tables)
                    counter.update(zip(in_twin(one, other, outcome).tolist(), one["cause"], strict=True))
        for outcome, counter in counts.items():
            line = f"{cell.name:32} {cell.lacks:10} {outcome:6}"
            for present in (True, False):
                total = sum(n for (there, _), n in counter.items() if there == present)
                blamed = sum(n for (there, c), n in counter.items() if there == present and c in BLAMED[cell.lacks])
                line += f" {total:8} {f'{blamed / total:.1%}' if total else '-':>7}"
            print(line, flush=True)
            if options.causes:
                for present in (True, False):
                    parts = sorted(((n, cause) for (there, cause), n in counter.items() if there == present))[::-1]
                    print("    ", "present:" if present else "new:", ", ".join(f"{cause} {n}" for n, cause in parts))


if __name__ == "__main__":
    main(sys.argv[1:])
