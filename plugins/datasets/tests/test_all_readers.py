"""Every reader recognises its files, plays in every shipped attack, and reads or refuses damaged files."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Any

import av2_writer
import carla_writer
import dair_writer
import mast_datasets
import numpy as np
import pytest
import rosbag_writer
import sumo_writer
from comparison import junction
from damages import DAMAGE, damaged
from fuzzing import Fuzzing
from hypothesis import given, settings
from hypothesis import strategies as st
from layouts import TWINS
from mast_datasets import traffic

import mast_zenoh as mast
from mast_zenoh.config.registry import recognised
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Scene, own_detections
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.testing import check_scene

#: Texts that replace a word of a file.
WORDS = ["", "-1", "1e400", "nan", ".nan", "9" * 50, "null", "[]", "{}", "--5", "<x>", "&a;", "<!DOCTYPE x>", "\x00"]
WORDS += ["!!python/tuple [1]", "*id001", "&id001 x", "\n", '"', "true"]


#: Further layouts that readers know.
LAYOUTS = {
    "DAIRScene, DAIR-V2X-C": lambda folder, source: dair_writer.write_c(folder, source, len(source)),
    "RosBag, MCAP": lambda folder, source: rosbag_writer.write_recording(folder, source, "mcap, zstd chunks"),
    "SumoTrace, CSV": lambda folder, source: sumo_writer.write_sumo(source, folder, "csv"),
}
#: Small scenes of the others.
OTHERS = {
    "AV2Log": lambda folder, source: av2_writer.write_log(folder),
    "AVstackScene": lambda folder, source: carla_writer.write_run(folder),
}


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By type of scene and layout, four frames of a junction with two vehicles and two poles as agents."""
    source = junction(frames=4)
    return {
        name: write(tmp_path_factory.mktemp("twin") / "scene", source)
        for name, write in {**TWINS, **LAYOUTS, **OTHERS}.items()
    }


def scene(name: str, path: Path, **options: Any) -> Scene:
    kind, _, layout = name.partition(", ")
    options |= dict(link_radius_m=2.0) if layout == "DAIR-V2X-C" else {}
    return getattr(mast_datasets, kind)(path=str(path), detector=CleanDetector(), **options)


def test_every_data_set_is_recognised_by_its_files(twins: dict[str, Path]) -> None:
    for name, path in twins.items():
        assert recognised(str(path)) == f"{getattr(mast_datasets, name.partition(', ')[0]).short_name}:{path}"
    assert {*TWINS, *OTHERS, "SumoTraffic"} == set(
        mast_datasets.__all__
    )  # the latter simulates, see test_sumo_traffic.py


def test_a_path_that_does_not_exist_is_refused_by_name(twins: dict[str, Path]) -> None:
    for name, path in twins.items():
        missing = path.with_name("nowhere")
        with pytest.raises(SceneError, match=f"{missing}: (no such f|found no folder)"):
            scene(name, missing).record(0, None)


def test_scenes_are_repeatable_and_shorter_ones_are_their_beginning(twins: dict[str, Path]) -> None:
    for name, path in twins.items():
        check_scene(scene(name, path))
        short, whole = (scene(name, path).record(0, frames) for frames in (2, None))
        np.testing.assert_array_equal(short.truth_at(1).velocity, whole.truth_at(1).velocity)
        np.testing.assert_array_equal(short.points_at(1), whole.points_at(1))
        total = len(whole)
        with pytest.raises(ConfigurationError, match=f"{total + 1} frames requested, the scene has {total}"):
            scene(name, path).record(0, total + 1)


def test_agents_that_the_data_does_not_have_are_refused(twins: dict[str, Path]) -> None:
    for name, path in twins.items():
        if name != "V2V4RealScene":  # which has no poles
            assert scene(name, path, n_mobile=0, n_infrastructure=1).record(0, 1).agent_names == ("ego", "infra_1")
        for option in ("n_mobile", "n_infrastructure"):
            for count in (-1, 99):
                with pytest.raises(ConfigurationError, match=f"{option} is {count}, expected 0"):
                    scene(name, path, **{option: count}).record(0, None)


@pytest.mark.parametrize("name", [*TWINS, *LAYOUTS])
def test_a_damaged_file_is_read_or_refused(name: str, twins: dict[str, Path], fuzzing: Fuzzing) -> None:
    @settings(max_examples=fuzzing.draws(15, 100), deadline=None)
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        read_damaged(name, twins[name], data)

    check()


def read_damaged(name: str, path: Path, data: st.DataObject) -> None:
    """Damage one file of a data set, and read that: only the errors of a scene may come of it."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    file = data.draw(st.sampled_from(files))
    content = file.read_bytes()
    if data.draw(st.booleans()):
        changed = damaged(content, data.draw(DAMAGE))
    else:
        start = content.rfind(b" ", 0, data.draw(st.integers(0, max(len(content) - 1, 0)))) + 1
        end = min(
            place for place in (content.find(b"\n", start), content.find(b" ", start), len(content)) if place >= 0
        )
        changed = content[:start] + data.draw(st.sampled_from(WORDS)).encode() + content[end:]
    try:
        file.write_bytes(changed)
        with contextlib.suppress(SceneError, ConfigurationError):
            scene(name, path).record(0, None).validate()
    finally:
        file.write_bytes(content)


@pytest.mark.parametrize(
    ("scene", "parameters", "message"),
    [
        (mast_datasets.OPV2VScene, dict(rate_hz=0), "rate_hz is 0, expected 0.01 to 1000"),
        (mast_datasets.TUMTrafV2X, dict(max_gap_s=0), "max_gap_s is 0, expected a number above 0"),
        (
            mast_datasets.CommonRoadScenario,
            dict(building_height_m=0.0),
            "building_height_m is 0.0, expected 0.1 to 1000",
        ),
        (mast_datasets.SumoTrace, dict(duration_s=0.0), "duration_s is 0.0, expected 0.001 to 100000"),
        (mast_datasets.SumoTrace, dict(radius_m=5.0), "radius_m is 5.0, expected 20 to 2000"),
        (mast_datasets.SumoTraffic, dict(rate_hz=3.0), "rate_hz is 3.0, expected one whose frames last"),
        (mast_datasets.SumoTraffic, dict(rate_hz=0.5), "rate_hz is 0.5, expected 1 to 20"),
        (mast_datasets.SumoTraffic, dict(n_infrastructure=17), "n_infrastructure is 17, expected 0 to 16"),
        (mast_datasets.SumoTraffic, dict(n_mobile=-1), "n_mobile is -1, expected 0 to 10000"),
        *(
            (mast_datasets.DAIRScene, {name: limit}, f"DAIRScene: {name} is .*, expected a number above 0")
            for name in ("max_time_difference_s", "max_gap_s", "match_radius_m", "link_radius_m")
            for limit in (0, -1.0, float("nan"), "far", True)
        ),
        *(
            (
                mast_datasets.AVstackScene,
                dict(max_unpacked_mb=limit),
                "max_unpacked_mb is .*, expected a number above 0",
            )
            for limit in (0, -1, float("nan"), float("inf"), "1 GB", None)
        ),
    ],
)
def test_parameters_that_cannot_be_are_refused(scene: type[Scene], parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        scene(path="somewhere", **parameters)


SEARCHED = ["OPV2VScene", "DAIRScene", "CommonRoadScenario", "SumoTrace", "AV2Log", "AVstackScene"]


@pytest.mark.parametrize("name", SEARCHED)
def test_one_of_several_in_a_folder_is_not_chosen(name: str, twins: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=f"{tmp_path.name}: (found 0|no run)"):
        scene(name, tmp_path).record(0, None)
    above = tmp_path / "above"
    above.mkdir()
    for copy in ("a", "b"):
        if name == "SumoTrace":
            (above / f"fcd_{copy}.xml").touch()
        elif twins[name].is_dir():
            shutil.copytree(twins[name], above / copy)
        else:
            shutil.copy(twins[name], above / f"{copy}.xml")
    with pytest.raises(SceneError, match=r"above: (found )?2 .*a.*, .*b.*, expected"):
        scene(name, above).record(0, None)


@pytest.mark.parametrize("name", ["TUMTrafV2X", "UrbanIngV2X", "DAIRScene", "RCooperScene"])
def test_scenes_beyond_the_limits_are_refused(
    name: str, twins: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    read = scene(name, twins[name])
    for module, limit, message in (
        (traffic, "MAX_BOXES", "found more than 3 boxes"),
        (own_detections, "MAX_FILE_BYTES", r"found \d+ bytes, expected at most 3"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(module, limit, 3)
            with pytest.raises(SceneError, match=message):
                read.record(0, None)


@pytest.mark.parametrize("name", ["OPV2VScene", "DAIRScene", "RosBag", "UrbanIngV2X"])
def test_baseline_and_attacks_play_on_data_sets(name: str, tmp_path: Path) -> None:
    """One of each kind of reader; what a run gets of the others is checked above."""
    path = TWINS[name](tmp_path / "scene", junction())
    scene = dict(type=name, path=str(path))
    pictures = []
    for scenario in ("baseline", "coordinated"):
        attack = {} if scenario == "baseline" else dict(n_adversaries=1, attack_start_s=0.3)
        run = mast.run(scenario, scene=scene, seed=0, out=tmp_path / scenario, record=False, report=False, **attack)
        pictures.append(run.summary["agents"]["ego"]["picture"])
    assert min(picture["tp"]["mean"] for picture in pictures) > 1
    assert pictures[1]["fp"]["mean"] > pictures[0]["fp"]["mean"]
