"""Measured effects of interposers equal their actions, row by row."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effects_oracle import expected
from observed_run import ObservedRun
from played import Played, play_observed
from shipped import HARMLESS

from mast_zenoh import scenario

pytestmark = pytest.mark.heavy

TAMPERER = str(Path(__file__).with_name("tamperer.py"))
TEXTS = ("interposer", "wire", "message", "before_subscriber", "effect", "columns")
WHOLE = ("frame", "seq", "id")


def measured(played: Played) -> list[dict[str, Any]]:
    """The rows of attacks.parquet in the format of the oracle."""
    table = played.table("attacks")
    rows = []
    for k in range(len(table["frame"])):
        row = {name: table[name][k] for name in (*TEXTS, *WHOLE, "delay_s")}
        for name, columns in (
            ("before", ("before_x", "before_y", "before_z")),
            ("after", ("after_x", "after_y", "after_z")),
            ("velocity", ("vx", "vy", "vz")),
        ):
            row[name] = tuple(table[column][k] for column in columns)
        rows.append(row)
    return rows


def compare(played: Played, process: ObservedRun) -> Counter[str]:
    """Assert that measured rows equal the oracle's; returns counts by effect."""

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        numbers = [row["delay_s"], *row["before"], *row["after"], *row["velocity"]]
        return (
            *(str(row[name]) for name in TEXTS),
            *(int(row[name]) for name in WHOLE),
            *np.round(np.nan_to_num(numbers, nan=-1e9), 5).tolist(),
        )

    measured_rows = sorted(measured(played), key=place)
    done = sorted(expected(process, played.metrics["frames"]), key=place)
    kinds = [Counter(row["effect"] for row in rows) for rows in (measured_rows, done)]
    assert kinds[0] == kinds[1]
    for measured_row, other in zip(measured_rows, done, strict=True):
        assert {name: measured_row[name] for name in (*TEXTS, *WHOLE)} == {
            name: other[name] for name in (*TEXTS, *WHOLE)
        }
        for name in ("delay_s", "before", "after", "velocity"):
            np.testing.assert_allclose(
                measured_row[name], other[name], rtol=0.0, atol=1e-8, err_msg=f"{name}: {measured_row}"
            )
    return kinds[0]


def test_effects_equal_the_oracles_in_every_shipped_scenario(shipped, variant):
    played, process = shipped(variant)
    kinds = compare(played, process)
    assert bool(kinds) == (variant[0] not in HARMLESS)
    for name, counts in played.metrics["interposers"].items():
        assert counts["agreement"] in ("agrees", "nothing to report"), (name, counts)


def chain(seed: int) -> dict[str, Any]:
    """A scenario with adversaries, tamperers and links on random wires."""
    rng = np.random.default_rng(seed)
    path, content = scenario.load("baseline", ["n_infrastructure=2", "agents.infra_1.acts=true"])
    adversaries: dict[str, Any] = {}
    rewrites: list[Any] = []
    for k in range(int(rng.integers(2, 5))):
        agent, message = str(rng.choice(["ego", "infra_1"])), str(rng.choice(["detections", "tracks", "picture"]))
        name = f"adversary_{k}"
        if message == "picture" or rng.random() < 0.6:
            adversaries[name] = dict(file=TAMPERER, agent=agent)
        else:
            selection = dict(type="UncoordinatedSelection", fraction_translations=0.3, n_false_positives=3.0)
            attack = dict(type="UncoordinatedAttack", start_s=0.4, selection=selection)
            adversaries[name] = dict(type="Adversary", agent=agent, attack=attack)
        wire = "cc/picture" if message == "picture" else f"agent/{agent}/{message}"
        before = dict(to="agent") if message == "picture" else {}
        insert = dict(wire=wire, role="adversary", input=message, output=f"{message}_out", node=name)
        rewrites.append({"insert": [insert | before]})
    rules = [
        dict(type="Loss", probability=0.1),
        dict(type="Delay", mean_s=0.15, jitter_s=0.1),
        dict(type="Duplicate", probability=0.2),
        dict(type="Corrupt", probability=0.1),
        dict(type="ClockSkew", offset_s=0.03),
        dict(type="PoseError", position_std_m=0.5, bias_yaw_rad=0.02),
        dict(type="Reorder", probability=0.2, by_s=0.25),
    ]

    def drawn() -> list[dict[str, Any]]:
        return [rules[k] for k in sorted(rng.choice(len(rules), int(rng.integers(1, 4)), replace=False))]

    content["links"] = {"infra_1": dict(up=drawn(), down=drawn()), "ego": dict(up=drawn())}
    if rng.random() < 0.4:
        rewrites.insert(0, "network.toml")
    content |= dict(name=f"chain_{seed}", adversaries=adversaries, keyexpr=dict(map="testbed.toml", rewrites=rewrites))
    return scenario.resolve(path, content, frames=24, seed=seed, record=True)


@pytest.mark.parametrize("seed", range(10))
def test_effects_equal_the_oracles_in_random_chains(seed: int, tmp_path: Path) -> None:
    played, process = play_observed(tmp_path, chain(seed))
    kinds = compare(played, process)
    assert sum(kinds.values()) > 50
