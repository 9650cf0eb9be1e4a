"""Achievements equal plain loops in every shipped scenario with an attack."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from achievement_oracle import Run, Target, rows, summary
from played import Played
from shipped import every, label

pytestmark = pytest.mark.heavy

ATTACKED = (
    "uncoordinated",
    "coordinated",
    "realistic_network",
    "attack_during_partition",
    "rogue",
    "downlink",
    "hide_object",
)
VARIANTS = [variant for variant in every() if variant[0] in ATTACKED]


@pytest.mark.parametrize("variant", VARIANTS, ids=label)
def test_achievements_equal_a_plain_loop(
    shipped: Callable[..., tuple[Played, object]], variant: tuple[str, ...]
) -> None:
    played, _ = shipped(variant)
    run, table = Run(played), rows(played.table("targets"))
    agents = list(played.agents)
    manipulated: set[Target] = set()
    for row in table:
        inserted = row["kind"] == "inserted"
        id_ = -1 if inserted else max(row["object"], -1)
        target = Target(row["adversary"], row["kind"], row["frame"], id_, row["x"], row["y"])
        manipulated.add(target)
        for judge, estimator, judges in (("centre", "picture", agents), ("ego", "mission", ["ego"])):
            verdict = run.verdict(target, estimator, judges)
            assert row[f"judged_{judge}"] == verdict.judged, (judge, row)
            assert row[f"believed_{judge}"] == verdict.believed, (judge, row)
            assert row[f"error_m_{judge}"] == pytest.approx(verdict.error_m, abs=1e-9, nan_ok=True)
    assert manipulated == run.targets()
    achieved = played.metrics["achieved"]
    adversaries = {name for name, each in played.metrics["interposers"].items() if each["role"] != "link"}
    assert achieved.keys() == (adversaries | {"all"} if adversaries else set())
    for name, values in achieved.items():
        selected = [row for row in table if name in ("all", row["adversary"])]
        for judge in ("centre", "ego"):
            for key, value in summary(selected, judge).items():
                assert values[key] == (None if value is None else pytest.approx(value, abs=1e-9)), (name, key)
