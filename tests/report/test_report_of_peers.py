"""Words on runs of peers: they name the agent that is deceived, and what of it is compromised."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.report.narrative.adversaries import attack_description, compromised, explanations
from mast_zenoh.report.narrative.run import defence_sentence, headline
from mast_zenoh.runs.run import Run

SETTINGS: dict[str, Any] = dict(n_infrastructure=2, n_mobile=1, attack_start_s=0.3, scene_index=8)


def run_of_peers(folder: Path, frames: int = 20, **settings: Any) -> Run:
    run = mast.run(
        "peers", runtime="inproc", frames=frames, out=folder / "run", report=False, record=False, **SETTINGS | settings
    )
    return Run(run.path)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of_peers(tmp_path_factory.mktemp("pair"), on="pair", listener="mobile_1", n_adversaries=1)


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of_peers(tmp_path_factory.mktemp("heard"), on="heard", n_adversaries=1, defence="FaultOrLie")


@pytest.fixture(scope="module")
def gossip(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of_peers(tmp_path_factory.mktemp("gossip"), gossip=True, n_adversaries=1, n_slanderers=1)


def test_the_headline_names_the_agent_in_whose_picture_the_errors_are(pair: Run) -> None:
    per_frame = pair.scores_of("picture", "mobile_1")["fp_split"]["attack"]
    assert per_frame > 0.0
    assert pair.scores_of("picture", "ego")["fp_split"]["attack"] == 0.0
    assert headline(pair) == (
        "What infra_1 sends to mobile_1 compromised: no error in the picture of the ego is due to attacks; "
        f"{per_frame:.2f} false objects a frame in the picture of mobile_1 are due to adversary_1"
    )


def test_an_adversary_on_the_way_to_another_peer_had_no_effect_on_the_ego(pair: Run) -> None:
    assert explanations(pair)["adversary_1"] == ("it sat on the path of messages to mobile_1, not to the ego",)
    assert attack_description(pair)[0].startswith("In the tracks of infra_1 on the way to mobile_1 alone, adversary_1 ")


def test_agents_are_not_compromised_by_changes_on_the_way_to_one_listener(heard: Run) -> None:
    assert compromised(heard) == "what the ego hears"
    assert "lied" not in defence_sentence(heard)
    assert "although what the ego hears of mobile_1, infra_1 and infra_2 is altered on the way" in defence_sentence(
        heard
    )


def test_of_several_judges_the_sentence_names_the_one_that_it_is_about(heard: Run) -> None:
    assert defence_sentence(heard).startswith("FaultOrLie of the ego's peer (the others judge for themselves) ")


def test_slander_is_described_as_what_it_is(gossip: Run) -> None:
    slander = next(text for text in attack_description(gossip) if "slanderer_1" in text)
    assert "changed the trust in agents that is told in " in slander
    (reason,) = explanations(gossip)["slanderer_1"]
    assert reason.startswith("it changed no single object that could be false or missed: ")
    assert reason.endswith(" messages slandered")


def test_the_headline_counts_only_objects_of_the_causes_that_it_names(gossip: Run) -> None:
    none = {"fault": 0.0, "attack": 0.0, "withheld": 0.0, "natural": 0.0}
    for name, estimate in gossip.files.summary["agents"]["ego"].items():
        missed = {} if name == "local" else {"attack": 0.02, "withheld": 0.30}
        estimate |= {"fp_split": none, "fn_split": none | missed, "id_switches_split": none}
    assert "0.30 missed objects a frame in the picture of the ego are due to Hearsay, which withheld" in headline(
        gossip
    )
