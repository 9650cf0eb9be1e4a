"""A cause is named only if two runs differ in adversaries alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.attribution import join_differences, other_differences, reaches
from mast_zenoh.report.narrative.run import headline, reading
from mast_zenoh.viewer.run import RunRecord

Edit = Callable[[dict[str, Any]], Any]


def edit(path: Path, change: Edit) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def centre(radius: float, **more: Any) -> dict[str, Any]:
    clustering = {"type": "Clustering", "assign_radius": radius} | more
    return {"role": "command_center", "config": {"pipeline": {"type": "Pipeline", "clustering": clustering}}}


@pytest.fixture
def pair(run_folder: Callable[..., Path]) -> tuple[Path, Path]:
    """The folders of an attacked run and of one without adversaries."""
    folders = run_folder("coordinated"), run_folder()
    for folder in folders:
        edit(folder / "scenario.json", lambda data: data.update(nodes={"command_center": centre(2.0)}))
    adversary = {"role": "adversary", "config": {"metres": 4.0}}
    edit(folders[0] / "scenario.json", lambda data: data["nodes"].update(adversary_1=adversary))
    return folders


def loaded(pair: tuple[Path, Path]) -> tuple[RunRecord, RunRecord]:
    return RunRecord.load(pair[0]), RunRecord.load(pair[1])


def sentences_of(run: RunRecord, reference: RunRecord) -> str:
    other = Reference(reference, "other")
    return " ".join([headline(run, other), *reading(run, other)])


def test_added_adversaries_and_their_wires_are_not_other_differences(pair: tuple[Path, Path]) -> None:
    assert other_differences(*loaded(pair)) == ()
    assert "than other, due to adversary_1 and adversary_2" in headline(
        loaded(pair)[0], Reference(loaded(pair)[1], "other")
    )


OTHERS: dict[str, tuple[str, Edit, str]] = {
    "a setting": (
        "scenario.json",
        lambda data: data["nodes"].update(command_center=centre(3.0)),
        "command_center.pipeline.clustering.assign_radius",
    ),
    "a part of another type": (
        "scenario.json",
        lambda data: data["nodes"].update(command_center=centre(3.0, type="Other")),
        "command_center.pipeline.clustering",
    ),
    "the pace": ("scenario.json", lambda data: data.update(mode="realtime"), "mode"),
    "the sensors": ("scenario.json", lambda data: data["scene"].update(noise_m=1.0), "scene.noise_m"),
    "a node": ("run.json", lambda data: data["nodes"].update(link_ego={"role": "link"}), "link_ego"),
    "a wire": ("wiring.json", lambda data: data["wires"].append({"key": "mine", "publisher": "ego"}), "wire mine"),
    "a version": ("run.json", lambda data: data["versions"].update({"mast-zenoh": "9"}), "version of mast-zenoh"),
    "a handler that failed": (
        "run.json",
        lambda data: data["nodes"]["broker"].update(failures=[{"handler": "on_tracks", "count": 3}]),
        "failures of broker",
    ),
}


@pytest.mark.parametrize("place", [0, 1], ids=["in the attacked run", "in the other"])
@pytest.mark.parametrize(("file", "change", "name"), OTHERS.values(), ids=OTHERS)
def test_no_cause_is_named_if_runs_differ_otherwise(
    pair: tuple[Path, Path], file: str, change: Edit, name: str, place: int
) -> None:
    edit(pair[place] / file, change)
    assert other_differences(*loaded(pair)) == (name,)
    text = sentences_of(*loaded(pair))
    assert f"than other; not attributed: the runs also differ in {name}" in text
    assert "due to" not in text


def test_only_three_differences_are_named() -> None:
    assert join_differences(("a", "b", "c", "d", "e")) == "a, b, c and 2 more"
    assert join_differences(("a", "b")) == "a and b"


def test_the_same_adversaries_with_other_settings_are_a_difference(pair: tuple[Path, Path], tmp_path: Path) -> None:
    run = RunRecord.load(pair[0])
    edit(pair[0] / "scenario.json", lambda data: data["nodes"]["adversary_1"]["config"].update(metres=1.5))
    edit(pair[0] / "metrics.json", lambda data: data["agents"]["ego"]["picture"]["fp"].update(mean=0.0))
    weaker = RunRecord.load(pair[0])
    assert "not attributed: the runs differ in adversary_1.metres" in sentences_of(run, weaker)
    assert "due to" not in sentences_of(run, weaker)


def test_increase_without_adversaries_is_not_attributed(pair: tuple[Path, Path]) -> None:
    edit(pair[1] / "metrics.json", lambda data: data["agents"]["ego"]["picture"]["fp"].update(mean=30.0))
    attacked, clean = loaded(pair)
    assert "not attributed: the runs differ in adversary_1, adversary_2 and coordinator" in sentences_of(
        clean, attacked
    )
    assert "due to" not in sentences_of(clean, attacked)


def test_a_decrease_has_no_cause(pair: tuple[Path, Path]) -> None:
    edit(pair[1] / "metrics.json", lambda data: data["agents"]["ego"]["picture"]["fp"].update(mean=30.0))
    text = headline(loaded(pair)[0], Reference(loaded(pair)[1], "other"))
    assert text.endswith("fewer false objects a frame in the common picture than other")


def test_unreachable_changes_are_not_attributed_to_an_adversary(pair: tuple[Path, Path]) -> None:
    edit(pair[0] / "metrics.json", lambda data: data["agents"]["ego"]["local"]["fn"].update(mean=30.0))
    run, reference = loaded(pair)
    assert headline(run, Reference(reference, "other")).endswith(
        "more missed objects a frame in what the ego sees alone than other, by no measured cause"
    )
    assert [reaches(run, "adversary_1", name) for name in ("local", "picture", "mission")] == [False, True, True]


def test_an_adversary_before_one_agent_reaches_neither_the_picture_nor_the_others(
    run_folder: Callable[..., Path],
) -> None:
    run = RunRecord.load(run_folder())
    wire = next(wire for wire in run.wiring["wires"] if wire["key"] == "cc/picture")
    leg = {"key": "cc/picture/@tap/ego/0", "from": "eve", "to": ["ego"], "before": "ego"}
    wire.update(interposers=["eve"], legs=[*wire["legs"], leg])
    assert [reaches(run, "eve", name) for name in ("picture", "picture_received", "mission")] == [False, True, True]
    assert not reaches(run, "eve", "mission", "infra_1")


def test_dropped_messages_can_be_the_cause(pair: tuple[Path, Path]) -> None:
    def change(data: dict[str, Any]) -> None:
        data["agents"]["ego"]["picture"] |= {"fn": {"mean": 30.0}, "fn_split": {"fault": 0.0, "attack": 0.0}}
        data["interposers"] = {"adversary_1": data["interposers"]["adversary_1"] | {"effects": {"dropped": 8}}}

    edit(pair[0] / "metrics.json", change)
    text = headline(loaded(pair)[0], Reference(loaded(pair)[1], "other"))
    assert text.endswith("more missed objects a frame in the common picture than other, due to adversary_1")
