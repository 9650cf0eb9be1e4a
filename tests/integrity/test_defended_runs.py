"""Runs with an integrity stage: the picture has fewer false objects."""

from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.testing.fixtures import play

__all__ = ["play"]

FRAMES, SEED = 50, 1


def false_objects(run: mast.Run, estimate: str = "picture") -> float:
    return float(run.summary["agents"]["ego"][estimate]["fp"]["mean"])


def unjudged(folders: pytest.TempPathFactory, adversaries: int) -> mast.Run:
    options = dict(frames=FRAMES, seed=SEED, n_adversaries=adversaries, report=False)
    return mast.run("defended", out=folders.mktemp("run"), **options)


@pytest.fixture(scope="module")
def undefended(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    return unjudged(tmp_path_factory, adversaries=1)


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    return unjudged(tmp_path_factory, adversaries=0)


def test_most_false_objects_of_one_adversary_are_withheld(play: Any, undefended: mast.Run, quiet: mast.Run) -> None:
    run = play("defended", frames=FRAMES, seed=SEED, defence="FreeSpace", n_adversaries=1, report=False)
    added = false_objects(undefended) - false_objects(quiet)
    assert false_objects(run) - false_objects(quiet) < 0.5 * added
    missed = [each.summary["agents"]["ego"]["picture"]["fn"]["mean"] for each in (run, undefended)]
    assert missed[0] < missed[1] + 0.05, "hardly any real object is withheld"


def test_the_egos_veto_removes_what_it_sees_through(play: Any, undefended: mast.Run) -> None:
    veto = {"agents.*.pipeline.mission": dict(type="FreeSpaceVeto", mission=dict(type="PictureFirst"))}
    run = play("defended", frames=FRAMES, seed=SEED, n_adversaries=1, report=False, **veto)
    assert false_objects(run, "mission") < false_objects(undefended, "mission") - 0.5
    assert false_objects(run) == false_objects(undefended), "the picture is the same"
