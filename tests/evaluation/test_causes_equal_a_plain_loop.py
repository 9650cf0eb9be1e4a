"""Causes of errors in every estimate equal plain loops over the tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import pytest
from causes_oracle import ATTACKS, Causes
from played import Played
from shipped import HARMLESS, every, label

pytestmark = pytest.mark.heavy

LINKLESS = ("baseline", "passthrough", "uncoordinated", "coordinated", "downlink", "hide_object")
VARIANTS = [variant for variant in every() if variant[0] in LINKLESS]


@pytest.mark.parametrize("variant", VARIANTS, ids=label)
def test_causes_equal_a_plain_loop(shipped: Callable[..., tuple[Played, object]], variant: tuple[str, ...]) -> None:
    """Scenarios without links, whose drops may also cause missing tracks."""
    played, _ = shipped(variant)
    causes = Causes(played)
    counts: Counter[str] = Counter()
    for row in causes.rows:
        cause, by = row["cause"], set(row["by"].split("+")) - {""}
        assert bool(cause) == (row["outcome"] in ("false", "missed")), row
        assert bool(by) == (cause in ATTACKS), row
        counts[cause] += 1
        if row["outcome"] == "missed":
            hidden = causes.hidden(row)
            if hidden:
                assert cause in hidden, row
                assert by == hidden[cause], row
            elif cause not in ATTACKS:
                assert cause == causes.natural_miss(row), row
        elif row["outcome"] == "false":
            if causes.shown(row):
                assert cause in ("inserted", "moved"), row
            elif cause not in ATTACKS:
                assert cause == causes.natural_track(row), row
            assert by <= causes.active(row), row
    assert bool(set(counts) & set(ATTACKS)) == (variant[0] not in HARMLESS)
    assert counts["link or fault"] == 0


def test_errors_in_every_estimate_are_split_into_fault_attack_and_natural(
    shipped: Callable[..., tuple[Played, object]], variant: tuple[str, ...]
) -> None:
    played, _ = shipped(variant)
    frames = 1 + played.metrics["scored_frames"][1] - played.metrics["scored_frames"][0]
    for agent, estimators in played.agents.items():
        for estimator, estimate in estimators.items():
            for what, total in (
                ("fp", estimate["fp"]["mean"]),
                ("fn", estimate["fn"]["mean"]),
                ("id_switches", estimate["id_switches"]),
            ):
                split = estimate[f"{what}_split"]
                assert sum(split.values()) == pytest.approx(total, abs=1e-9), (agent, estimator, what)
                counts = Counter(estimate["causes"][what])
                per = 1 if what == "id_switches" else frames
                assert split["attack"] == pytest.approx(sum(counts[cause] for cause in ATTACKS) / per)
                assert split["fault"] == pytest.approx(counts["link or fault"] / per)
