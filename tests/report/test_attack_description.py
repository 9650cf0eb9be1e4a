"""The report says plainly what the attack was, from what was measured on the wires."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.report.html import write_report
from mast_zenoh.report.narrative.adversaries import attack_description
from mast_zenoh.viewer.run import RunRecord

RunFolderFixture = Callable[..., Path]


def edited(folder: Path, name: str, change: Callable[[Any], None]) -> RunRecord:
    """The run after a change of one of its JSON files."""
    content = json.loads((folder / name).read_text())
    change(content)
    (folder / name).write_text(json.dumps(content))
    return RunRecord.load(folder)


def test_each_adversary_has_a_sentence_with_its_place_its_effects_and_its_time(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")
    sentences = attack_description(RunRecord.load(folder))
    assert len(sentences) == 2
    assert sentences[0].startswith("In the detections of infra_1, adversary_1 inserted ")
    assert sentences[0].endswith("from t = 1.5 s to 3.9 s.")
    page = write_report(folder).read_text()
    assert sentences[0] in page.replace("&#39;", "'")
    assert page.index(sentences[0]) < page.index("<h2")


def test_a_run_without_adversaries_says_so_and_names_its_faults(run_folder: RunFolderFixture) -> None:
    folder = run_folder("baseline")
    (folder / "wiring.json").unlink()  # names adversaries, in every run of these tests
    run = edited(folder, "metrics.json", lambda content: content.pop("interposers"))
    assert attack_description(run) == ["No adversary took part in this run."]
    faults = [{"label": f"loss {n}", "kind": "fault", "at_s": float(n), "until_s": None} for n in range(5)]
    run = edited(folder, "scenario.json", lambda scenario: scenario.update(timeline=faults))
    expected = "The scenario also has faults: loss 0 from t = 0 s, loss 1 from t = 1 s, loss 2 from t = 2 s and 2 more."
    assert attack_description(run)[-1] == expected


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"dropped": 3, "delayed": 1}, "delayed 1 message and dropped 3 messages"),
        ({"forged": 2}, "forged 2 messages"),
        ({"moved": 7}, "moved objects (7 rows)"),
        ({"sung": 2}, "sung 2 messages"),
    ],
)
def test_every_kind_of_effect_is_described(run_folder: RunFolderFixture, effects: dict[str, int], words: str) -> None:
    folder = run_folder("uncoordinated")
    (folder / "targets.parquet").unlink(missing_ok=True)
    run = edited(folder, "metrics.json", lambda content: content["interposers"]["adversary_1"].update(effects=effects))
    assert words in attack_description(run)[0]


def test_idle_unmeasured_and_live_adversaries_are_distinguished(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")

    def change(content: dict[str, Any]) -> None:
        content["interposers"]["adversary_1"]["effects"] = {}
        del content["interposers"]["adversary_2"]["effects"]

    assert attack_description(edited(folder, "metrics.json", change)) == [
        "adversary_1 changed nothing.",
        "What adversary_2 did was not measured.",
    ]
    folder = run_folder("coordinated")
    events = [
        {"action": "intercept", "node": "adversary_1", "frame": 15, "wires": ["agent/infra_1/detections"]},
        {"action": "release", "node": "adversary_1", "frame": 30, "wires": []},
    ]
    run = edited(folder, "run.json", lambda record: record.update(interceptions=events))
    assert attack_description(run)[0].endswith("after it was inserted live in frame 15, and removed in frame 30.")


def test_a_coordinator_is_named_and_many_adversaries_are_summed_up(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")

    def add(content: dict[str, Any]) -> None:
        for number in range(3, 9):
            content["interposers"][f"adversary_{number}"] = content["interposers"]["adversary_1"]

    edited(folder, "metrics.json", add)
    run = edited(
        folder, "scenario.json", lambda scenario: scenario.update(nodes={"boss": {"role": "coordinator", "config": {}}})
    )
    run.run["nodes"]["boss"] = {"role": "coordinator"}
    sentences = attack_description(run)
    assert sentences[3] == "Five other adversaries did the same kind of thing: see the table of interposers."
    assert sentences[4] == "boss directed the adversaries."
