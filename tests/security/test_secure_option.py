"""`mast run --secure` with and without a level, and invalid uses."""

import pytest
from typer.testing import CliRunner

from mast_zenoh.cli import app
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.launch import run as launcher


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """Runs `mast run` up to the start of the run; returns (levels, output)."""
    levels: list[str] = []

    def run(*_: object, secure: str, **__: object) -> None:
        levels.append(secure)
        raise RunFolderError("the run would start here")

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
def test_the_security_level_is_optional(chosen, words: tuple[str, ...], level: str) -> None:
    assert chosen(*words)[0] == [level]


@pytest.mark.parametrize("words", [("--runtime", "inproc"), ("--endpoint", "tcp/127.0.0.1:1"), ("--secure=tlss",)])
def test_combinations_that_cannot_be_secured_are_refused(chosen, words: tuple[str, ...]) -> None:
    levels, output = chosen("baseline", "--secure", *words)
    assert levels == []
    assert "--secure" in output


@pytest.mark.parametrize("level", ["aclx", "ACL", "mtsl"])
def test_a_misspelt_level_is_not_mistaken_for_a_scenario(level: str) -> None:
    ended = CliRunner().invoke(app.app, ["run", "baseline", "--secure", level])
    assert isinstance(ended.exception, ConfigurationError)
    assert f"level: found {level!r}" in str(ended.exception)


def test_a_study_of_outsiders_refuses_trials() -> None:
    ended = CliRunner().invoke(app.app, ["study", "rogue", "--trials", "3"])
    assert ended.exit_code == 2
    assert "each level" in ended.output
