"""The ego with the picture is never worse off than alone, and results tell how old its pictures are."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from played import Played

import mast_zenoh as mast
from mast_zenoh.scenario import load

#: m, errors of the four poles' positions, as from a bad survey.
BAD_SURVEY = [(0.8, 0.0), (0.0, 0.8), (-0.6, 0.6), (0.5, -0.6)]


def played(out: Path, scene: int, errors: list[tuple[float, float]]) -> mast.Run:
    content = dict(load("baseline", [f"scene_index={scene}"])[1])
    content["links"] = {
        f"infra_{k}": dict(up=[dict(type="PoseError", bias_m=list(bias))]) for k, bias in enumerate(errors, 1)
    }
    return mast.run(content, frames=60, seed=5, record=False, out=out)


def errors_m(objects: pd.DataFrame, estimator: str) -> pd.Series:
    """m, horizontal error of each matched object of the ego's estimate, by frame and object."""
    matched = objects[(objects.agent == "ego") & (objects.estimator == estimator) & (objects.outcome == "matched")]
    truth, tracks = matched[matched.kind == "truth"], matched[matched.kind == "track"]
    pairs = truth.merge(tracks, left_on=["frame", "id"], right_on=["frame", "match_id"], suffixes=("", "_of_track"))
    error = np.hypot(pairs.x - pairs.x_of_track, pairs.y - pairs.y_of_track)
    return pd.Series(error.to_numpy(), index=pd.MultiIndex.from_frame(pairs[["frame", "id"]]))


@pytest.mark.parametrize("survey", [[], BAD_SURVEY], ids=["surveyed well", "surveyed badly"])
def test_the_mission_estimate_is_as_exact_as_own_tracks_and_keeps_its_ids(tmp_path, survey):
    run = played(tmp_path / "run", 1, survey)
    objects = run.objects.to_pandas()
    alone, mission = errors_m(objects, "local"), errors_m(objects, "mission")
    both = alone.index.intersection(mission.index)
    assert len(both) > 300
    assert np.sqrt((mission[both] ** 2).mean()) < np.sqrt((alone[both] ** 2).mean())
    switches = {name: run.summary["agents"]["ego"][name]["id_switches"] for name in ("local", "picture", "mission")}
    assert switches["mission"] <= switches["local"] + switches["picture"] + 2


def test_results_tell_how_old_the_pictures_are_that_agents_use(once: Callable[..., Played]) -> None:
    baseline, late = once("baseline"), once("baseline", "broker.latency_s=0.3")
    for played, age_s in ((baseline, 0.1), (late, 0.4)):
        assert set(played.metrics["picture_age_s"]) == {"ego"}
        ages = played.metrics["picture_age_s"]["ego"]
        assert ages["mean"] == pytest.approx(age_s)
        assert ages["max"] == pytest.approx(age_s)
        assert ages["frames_without"] == 0
