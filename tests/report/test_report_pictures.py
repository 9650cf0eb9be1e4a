"""What the report and the terminal say of runs in which each agent has a picture of its own."""

from __future__ import annotations

import pytest

import mast_zenoh as mast
from mast_zenoh.report.findings.defence import of_pictures
from mast_zenoh.report.findings.words import said
from mast_zenoh.report.tables.pictures import picture_table
from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.run import Run


@pytest.fixture(scope="module")
def radio(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    out = tmp_path_factory.mktemp("radio") / "run"
    options = dict(
        runtime="inproc", frames=30, out=out, n_infrastructure=2, n_mobile=1, n_adversaries=1, attack_start_s=1.0
    )
    return mast.run("congested", report=False, **options)


def test_each_agent_has_a_line_with_the_scores_of_its_own_picture(radio: mast.Run) -> None:
    record = Run(radio.path)
    lines = {line.cells[0]: line.cells for line in picture_table(record).lines}
    assert set(lines) == {"ego", "mobile_1", "infra_1", "infra_2"}
    missed = radio.summary["agents"]["infra_2"]["picture"]["fn"]["mean"]
    assert lines["infra_2"][1] == f"{missed:.2f}"
    assert lines["infra_1"][4] == "0"  # the liar's own picture is right
    assert int(lines["ego"][4]) > 0


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
    assert said(run, of_pictures(run)) == [
        "3 agents have pictures of their own; GOSPA between two: 4.0 m, mostly objects that one of them lacks",
        "Attacks deceived 13 % of them at a time, at most 88 %, first at 2.0 s",
        "Errors are larger than covariances say (NEES above its 95 % bounds, 2 expected): "
        "positions in 2 of 3 pictures (on average 44.1)",
    ]
