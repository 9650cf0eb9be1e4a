"""From a spoofer's pulses to the brake: the same in process and on the mesh, and in tables of causes."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.launch import twin as unattacked
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.run_folder.tables import from_arrow

FRAMES = 60
SETTINGS: dict[str, Any] = dict(frames=FRAMES, attack_start_s=2.0, n_infrastructure=1, **{"points.recorded": True})


@pytest.fixture(scope="module")
def spoofed(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """Phantom points at the ego's lidar from 2 s on."""
    folder = tmp_path_factory.mktemp("spoofed") / "run"
    return mast.run("spoofed", out=folder, runtime="inproc", **SETTINGS)


def test_false_objects_are_made_of_the_points_that_a_spoofer_inserted(spoofed: mast.Run) -> None:
    effects, objects = from_arrow(spoofed.attacks), from_arrow(spoofed.objects)
    inserted = (effects["effect"] == "inserted") & (effects["message"] == "points")
    assert set(effects["interposer"]) == {"spoofer_1"}
    assert set(effects["wire"][inserted]) == {"agent/ego/points"}
    assert 0 < effects["points"][inserted].max() <= 200, "its budget"
    assert effects["frame"].min() == 20
    false = (objects["cause"] == "inserted") & (objects["by"] == "spoofer_1")
    assert {"local", "picture", "mission"} <= set(objects["estimator"][false])
    report = spoofed.report().read_text("utf-8")
    assert re.search(r"in the picture in \d+ scored frames? are made of \d+ points a scan that spoofer_1", report)


def test_without_a_spoofer_nothing_is_false_because_of_it_and_the_car_drives_on(
    spoofed: mast.Run, tmp_path: Path
) -> None:
    settings = {name: value for name, value in SETTINGS.items() if name != "attack_start_s"}
    twin = mast.run("spoofed", out=tmp_path / "twin", runtime="inproc", attack="none", **settings)
    assert not len(twin.attacks)
    assert compare(twin.path, unattacked.of(spoofed.path)).first is None, "the same hedges, however the ego was driven"
    driven = [from_arrow(run.driven) for run in (twin, spoofed)]
    np.testing.assert_array_equal(*(each["x"][:20] for each in driven))
    assert driven[0]["speed_mps"][-1] > driven[1]["speed_mps"][-1] + 1.0, "the ego brakes for the phantom"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (dict(attack="phantm"), "attack: no attack named 'phantm'; did you mean 'phantom'"),
        (dict(attack="CutIn"), "CutIn changes no points, expected one of HighFrequencyRemoval, .*, ForgedMesh"),
        (dict(attack=dict(type="Slander")), "Slander changes no points"),
        (dict(attack_start_s="2s"), "attack_start_s: found '2s', expected a number, in s"),
        (dict(checks="OclusionCheck"), "did you mean 'OcclusionCheck'"),
        (dict(detector="ClusterDetectr"), "did you mean 'ClusterDetector'"),
        (dict(victim="nobody"), "no agent 'nobody'"),
        (dict(attack="none", attack_start_s=3.0), "attack_start_s: found 3.0, expected nothing: it needs an attack"),
    ],
)
def test_what_is_wrong_with_a_spoofed_scenario_is_named(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(mast.MastError, match=message):
        mast.run("spoofed", frames=2, runtime="inproc", **settings)


def test_names_of_checks_are_separated_by_commas_and_none_stands_for_nothing() -> None:
    _, content = scenario.load("spoofed", ["checks=ShadowCheck,OcclusionCheck", "lidar=None", "clutter=none"])
    finds = dict(type="CheckedDetector", detector=dict(type="ClusterDetector"))
    checks = [dict(type="ShadowCheck"), dict(type="OcclusionCheck")]
    assert content["points"] == dict(
        lidar=None, clutter=None, detector=finds | dict(checks=checks), detected_by="detector"
    )
    _, content = scenario.load("spoofed", ["checks=none", "attack=None"])
    assert content["points"]["detector"] == dict(type="ClusterDetector")
    assert "adversaries" not in content


def test_the_list_of_scenarios_says_that_attacks_and_checks_may_be_in_files() -> None:
    meanings = {parameter.name: parameter.meaning for parameter in mast.list("scenarios")["spoofed"].parameters}
    assert all("FILE.py:CLASS" in meanings[name] for name in ("attack", "checks"))


@pytest.mark.heavy
@pytest.mark.timeout(300)
def test_spoofed_is_the_same_on_the_mesh(spoofed: mast.Run, tmp_path: Path) -> None:
    mesh = mast.run("spoofed", out=tmp_path / "mesh", runtime="mesh", **SETTINGS)
    difference = compare(spoofed.path, mesh.path)
    assert difference.first is None
    assert any(message.type == "points" for message in mesh.messages("agent/ego/points")), "scans are recorded, too"
