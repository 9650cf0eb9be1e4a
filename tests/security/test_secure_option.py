"""`mast run --secure`: with a level, without one, and refused where it is not possible."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from mast_zenoh.cli import app
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.launch import run as launcher


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """Run `mast run` until just before the run begins: (its level, the console output)."""
    levels: list[str] = []

    def run(*_: object, secure: str, **__: object) -> None:
        levels.append(secure)
        raise RunFolderError("far enough")

    monkeypatch.setattr(launcher, "run", run)

    def invoke(*words: str) -> tuple[list[str], str]:
        levels.clear()
        ended = CliRunner().invoke(app.app, ["run", *words])
        return levels.copy(), ended.output

    return invoke


@pytest.mark.parametrize(
    ("words", "level"),
    [
        (("baseline",), "open"),
        (("--secure", "baseline"), "acl"),
        (("baseline", "--secure"), "acl"),
        (("baseline", "--secure", "--frames", "3"), "acl"),
        (("baseline", "--secure", "mtls"), "mtls"),
        (("--secure=tls", "baseline"), "tls"),
    ],
)
def test_the_level_may_be_left_out(chosen, words: tuple[str, ...], level: str) -> None:
    assert chosen(*words)[0] == [level]


@pytest.mark.parametrize("words", [("--runtime", "inproc"), ("--endpoint", "tcp/127.0.0.1:1"), ("--secure=tlss",)])
def test_the_option_is_refused_where_there_is_no_mesh(chosen, words: tuple[str, ...]) -> None:
    levels, said = chosen("baseline", "--secure", *words)
    assert levels == []
    assert "--secure" in said


@pytest.mark.parametrize("level", ["aclx", "ACL", "mtsl"])
def test_a_misspelt_level_is_not_taken_for_a_scenario(level: str) -> None:
    ended = CliRunner().invoke(app.app, ["run", "baseline", "--secure", level])
    assert isinstance(ended.exception, ConfigurationError)
    assert f"security level: found {level!r}" in str(ended.exception)


def test_a_study_of_an_outsider_refuses_trials() -> None:
    ended = CliRunner().invoke(app.app, ["study", "rogue", "--trials", "3"])
    assert ended.exit_code == 2
    assert "once at each level" in ended.output
