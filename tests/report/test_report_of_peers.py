"""Pages and words on runs of peers: they speak of no centre, and name the agent that is deceived."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kept_texts import visible
from rich.console import Console

import mast_zenoh as mast
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.run import Run
from mast_zenoh.show.film.takes import Take
from mast_zenoh.show.findings import outcome
from mast_zenoh.show.findings.adversaries import attacks, limits, positions
from mast_zenoh.show.findings.defence import of_defence, of_pictures
from mast_zenoh.show.findings.words import defence_line, said
from mast_zenoh.show.tables.of_run import picture_table
from mast_zenoh.show.terminal import show_run

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
def judged(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    settings = dict(n_infrastructure=3, n_mobile=1, n_adversaries=1, attack_start_s=0.3, defence="Pasac")
    out = tmp_path_factory.mktemp("peers") / "run"
    return mast.run("peers", frames=12, seed=3, report=False, **settings, out=out)


@pytest.fixture(scope="module")
def radio(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    sizes = dict(n_infrastructure=2, n_mobile=1, n_adversaries=1, attack_start_s=1.0)
    return mast.run("congested", report=False, frames=30, out=tmp_path_factory.mktemp("radio") / "run", **sizes)


@pytest.fixture(scope="module")
def gossip(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of_peers(tmp_path_factory.mktemp("gossip"), gossip=True, n_adversaries=1, n_slanderers=1)


def test_the_headline_names_the_agent_in_whose_picture_the_errors_are(pair: Run) -> None:
    per_frame = pair.scores_of("picture", "mobile_1")["fp_split"]["attack"]
    assert per_frame > 0.0
    assert pair.scores_of("picture", "ego")["fp_split"]["attack"] == 0.0
    where, unchanged, change = outcome(pair)
    assert where.kind == "adversaries"
    assert where.parts == (Finding("place", ("infra_1",), "path", where="mobile_1"),)
    assert (unchanged.kind, unchanged.who, unchanged.where) == ("unchanged", ("ego",), "picture")
    assert (change.who, change.where, change.value) == (("mobile_1",), "picture", per_frame)
    assert change.cause == ("adversary_1",)
    assert said(pair, [change])[0].endswith("due to adversary_1")


def test_an_adversary_on_the_way_to_another_peer_had_no_effect_on_the_ego(pair: Run) -> None:
    assert [each.cause for each in limits(pair)] == [("elsewhere", "mobile_1")]
    assert attacks(pair)[0].where.endswith(" only before peer_mobile_1")


def test_agents_are_not_compromised_by_changes_on_the_way_to_one_listener(heard: Run) -> None:
    (path,) = positions(heard)[0].parts
    assert (len(path.who), path.where) == (3, "ego")
    judged = {each.what: each.who for each in of_defence(heard)}
    assert "never suspended" not in judged
    assert set(judged["altered on the way"]) == {"mobile_1", "infra_1", "infra_2"}


def test_of_several_judges_the_sentence_names_the_one_that_it_is_about(heard: Run) -> None:
    line = defence_line(heard, of_defence(heard))
    assert line.startswith("FaultOrLie of the")


def test_slander_is_described_as_what_it_is(gossip: Run) -> None:
    (did,) = (each for each in attacks(gossip) if each.who == ("slanderer_1",))
    (slander,) = did.parts
    assert (slander.what, slander.unit) == ("slandered", "messages")
    (reason,) = (each for each in limits(gossip) if each.who == ("slanderer_1",))
    assert reason.cause == ("no object",)
    assert reason.parts == (slander,)


def test_the_headline_counts_only_objects_of_the_causes_that_it_names(gossip: Run) -> None:
    none = {"fault": 0.0, "attack": 0.0, "withheld": 0.0, "natural": 0.0}
    for name, estimate in gossip.files.summary["agents"]["ego"].items():
        missed = {} if name == "local" else {"attack": 0.02, "withheld": 0.30}
        estimate |= {"fp_split": none, "fn_split": none | missed, "id_switches_split": none}
    (change,) = (each for each in outcome(gossip) if each.kind == "change")
    assert (change.what, change.value, change.where) == ("missed", 0.3, "picture")
    assert change.cause[0].startswith("Hearsay, which withheld")


@pytest.mark.usefixtures("unpainted")
def test_pages_films_and_the_terminal_speak_of_the_ego_and_its_peer(judged: mast.Run) -> None:
    console = Console(file=io.StringIO(), width=1000)
    show_run(console, judged.path)
    page, terminal = visible(judged.report()), console.file.getvalue()
    for text in (page, terminal, judged.headline):
        assert "common picture" not in text
        assert "command centre" not in text
    assert "picture of the" in page
    assert "the ego peer" in page
    assert "ego peer suspended" in terminal
    run = Run(judged.path)
    assert not run.has_centre
    assert "of the ego" in Take(run, "picture").title
    begins = [span["begins"] for span in spans(run, np.arange(12) * run.period_s) if span["kind"] == "suspension"]
    assert begins
    assert all(each.startswith("the ego peer") for each in begins)


def test_each_agent_has_a_line_with_the_scores_of_its_own_picture(pair: Run) -> None:
    lines = {line[0]: line for line in picture_table(pair).lines}
    assert set(lines) == {"ego", "mobile_1", "infra_1", "infra_2"}
    missed = pair.files.summary["agents"]["infra_2"]["picture"]["fn"]["mean"]
    assert lines["infra_2"][1] == f"{missed:.2f}"
    assert lines["infra_1"][4] == "0"  # the liar's own picture is right
    assert int(lines["mobile_1"][4]) > 0


@pytest.mark.heavy
def test_the_page_tells_whom_attacks_deceived_and_how_busy_the_channel_was(radio: mast.Run) -> None:
    page = radio.report().read_text()
    record = Run(radio.path)
    told = of_pictures(record)
    assert [each.kind for each in told if each.kind != "overconfident"] == [
        "pictures",
        "deceived",
        "channel",
        "channel",
    ]
    for sentence in said(record, told):
        assert sentence in page


def test_the_pictures_whose_errors_exceed_their_covariances_are_counted() -> None:
    above = {"position": {"nees": 44.12, "above": ["ego", "b"]}, "velocity": {"nees": 1.0, "above": []}}
    pictures = {
        "count": 3,
        "difference_gospa_m": {"mean": 4.04},
        "deceived": {"first_s": 2.0, "share": {"mean": 0.125}, "most": 0.875},
        "consistency": above,
    }
    run = Run.of(RunFiles(None, summary={"pictures": pictures}))
    own, deceived, overconfident = said(run, of_pictures(run))
    assert "4.0 m" in own
    assert all(value in deceived for value in ("13 %", "88 %", "2.0 s"))
    assert overconfident.endswith("positions in 2 of 3 pictures (on average 44.1)")
