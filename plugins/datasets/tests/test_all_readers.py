"""Every reader recognises its files, plays in every shipped attack, and reads or refuses damaged files."""

from __future__ import annotations

import contextlib
from pathlib import Path

import dair_writer
import label_twins
import mast_datasets
import pytest
import sumo_writer
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import TWINS

import mast_zenoh as mast
from mast_zenoh.config.scene_names import recognised
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Intersection
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector

#: Texts that replace a word of a file.
WORDS = ["", "-1", "1e400", "nan", ".nan", "9" * 50, "null", "[]", "{}", "--5", "<x>", "&a;", "<!DOCTYPE x>", "\x00"]
WORDS += ["!!python/tuple [1]", "*id001", "&id001 x", "\n", '"', "true"]


#: Further layouts that readers know.
LAYOUTS = {
    "DAIRScene, DAIR-V2X-C": lambda folder, source: dair_writer.write_c(folder, source, len(source)),
    "SumoTrace, CSV": lambda folder, source: sumo_writer.write_sumo(source, folder, "csv"),
}


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By type of scene and layout, four frames of a junction with two vehicles and two poles as agents."""
    source = Intersection(scene_index=0, n_infrastructure=2, n_mobile=1).record(0, 4)
    return {
        name: write(tmp_path_factory.mktemp("twin") / "scene", source) for name, write in {**TWINS, **LAYOUTS}.items()
    }


def read(name: str, path: Path) -> Recording:
    kind, _, layout = name.partition(", ")
    options = dict(link_radius_m=2.0) if layout == "DAIR-V2X-C" else {}
    return getattr(mast_datasets, kind)(path=str(path), detector=CleanDetector(), **options).record(0, None)


def test_every_data_set_is_recognised_by_its_files_and_read(twins: dict[str, Path]) -> None:
    for name, path in twins.items():
        assert recognised(str(path)) == f"{getattr(mast_datasets, name.partition(', ')[0]).short_name}:{path}"
        assert len(read(name, path)) == 4
    assert TWINS.keys() | {"AV2Log", "AVstackScene"} == set(mast_datasets.__all__), "no other reader has a twin"


@settings(max_examples=70, deadline=None)
@given(data=st.data())
@pytest.mark.parametrize("name", [*TWINS, *LAYOUTS])
def test_a_damaged_file_is_read_or_refused(name: str, twins: dict[str, Path], data: st.DataObject) -> None:
    path = twins[name]
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    file = data.draw(st.sampled_from(files))
    content = file.read_bytes()
    if data.draw(st.booleans()):
        changed = label_twins.damaged(content, data.draw(label_twins.DAMAGE))
    else:
        start = content.rfind(b" ", 0, data.draw(st.integers(0, max(len(content) - 1, 0)))) + 1
        end = min(
            place for place in (content.find(b"\n", start), content.find(b" ", start), len(content)) if place >= 0
        )
        changed = content[:start] + data.draw(st.sampled_from(WORDS)).encode() + content[end:]
    try:
        file.write_bytes(changed)
        with contextlib.suppress(SceneError, ConfigurationError):
            read(name, path).validate()
    finally:
        file.write_bytes(content)


@pytest.mark.parametrize("name", TWINS)
def test_baseline_and_attacks_play_on_every_data_set(name: str, tmp_path: Path) -> None:
    path = TWINS[name](tmp_path / "scene", label_twins.source())
    scene = dict(type=name, path=str(path))
    pictures = []
    for scenario in ("baseline", "coordinated", "uncoordinated"):
        attack = {} if scenario == "baseline" else dict(n_adversaries=1, attack_start_s=0.3)
        run = mast.run(scenario, scene=scene, seed=0, out=tmp_path / scenario, record=False, report=False, **attack)
        pictures.append(run.summary["agents"]["ego"]["picture"])
    assert min(picture["tp"]["mean"] for picture in pictures) > 1
    assert min(picture["fp"]["mean"] for picture in pictures[1:]) > pictures[0]["fp"]["mean"]
