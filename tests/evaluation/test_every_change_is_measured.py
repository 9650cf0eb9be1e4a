"""Changes by an adversary are measured and attributed despite its reports."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from played import Played, files_of

Once = Callable[..., Played]


def test_the_tutorials_silent_attacker_is_measured_and_blamed(once: Once) -> None:
    """It moves every detection of infra_1 by 3 m from the first frame."""
    files = {name: text for name, text in files_of("tutorial.md").items() if name in ("shover", "shoved")}
    attacked, baseline = once("shoved", **files), once("baseline")
    attacks = attacked.table("attacks")
    assert set(attacks["interposer"]) == {"mallory"}
    assert set(attacks["effect"]) == {"moved"}
    assert not attacks["reported"].any()
    assert attacks["frame"].min() == 0
    assert len(set(attacks["frame"])) == attacked.metrics["frames"], "in every frame"
    offset = np.column_stack([attacks[f"after_{axis}"] - attacks[f"before_{axis}"] for axis in "xyz"])
    assert np.linalg.norm(offset, axis=1) == pytest.approx(3.0)
    verdict = attacked.metrics["interposers"]["mallory"]
    assert verdict["agreement"] == "silent"
    assert verdict["effects"] == {"moved": len(attacks["frame"])}
    before, after = (played.agents["ego"]["picture"] for played in (baseline, attacked))
    added = after["fp"]["mean"] - before["fp"]["mean"]
    assert added > 2.0
    assert after["fp_split"]["attack"] == pytest.approx(added, rel=0.25)
    assert after["fp_split"]["natural"] == pytest.approx(before["fp_split"]["natural"], abs=0.25 * added)
    objects = attacked.table("objects")
    assert set(objects["by"]) == {"", "mallory"}
