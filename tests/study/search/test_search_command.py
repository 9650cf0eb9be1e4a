"""`mast study` with a search: a few real runs, its exit codes, and what it prints."""

from __future__ import annotations

import inspect
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from synthetic_search import write_study

from mast_zenoh.attacks.coordination import Collusion
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import definition
from mast_zenoh.study.search import searching


@pytest.mark.heavy
@pytest.mark.usefixtures("unpainted")
def test_a_small_search_is_played_printed_and_continued(mast, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    study = write_study(tmp_path, trials=2, candidates=3, batch=3, seeds=1)
    words = ("study", str(study), "--out", str(tmp_path / "out"))
    code, printed, _ = mast(*words, "--jobs", "2")
    assert code == 0
    table = [line for line in printed.splitlines() if not line.startswith(("/", "report: "))]
    assert max(map(len, table)) <= 80
    text = " ".join(printed.split())
    for part in (
        "No attack: baseline. Default: attacked.",
        "false_positives 0.0..10.0 1",
        "negatives 0.0..1.0 0.2",
        "Optimism of the search",
    ):
        assert part in text
    assert f"report: {tmp_path / 'out' / 'report.html'}" in printed
    found = json.loads((tmp_path / "out" / "search.json").read_text())
    assert all(each["value"] >= 0.0 for each in found["candidates"])
    assert (found["search_seeds"], found["held_out_seeds"]) == ([3], [4, 5])
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "trials").iterdir()}
    code, longer, _ = mast(*words, "--jobs", "1", "--candidates", "4", "--resume")
    assert code == 0
    assert "of 4" in longer
    again = json.loads((tmp_path / "out" / "search.json").read_text())
    assert again["candidates"][:3] == found["candidates"]
    assert files.items() <= {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "trials").iterdir()}.items()


def test_without_optuna_a_search_names_the_command_that_installs_it(mast, monkeypatch, tmp_path: Path) -> None:
    for name in [each for each in sys.modules if each.startswith("mast_zenoh.study.search")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optuna", None)
    code, _, err = mast("study", str(write_study(tmp_path)), "--jobs", "1", "--out", str(tmp_path / "out"))
    assert code == ConfigurationError.exit_code == 10
    assert "a search needs Optuna, which is not installed: pip install 'mast-zenoh[search]'" in " ".join(err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("search", "--set", "ranges=attack.sped_mps=0.0..1.0"), 10, "did you mean 'speed_mps'"),
        (("search", "--set", "ranges=attack.speed_mps=1.0"), 10, "expected 'LOW..HIGH'"),
        (("search", "--set", "objective=driving.min_ttc_s"), 10, "expected 'driving.critical'"),
        (("search", "--set", "objective=fn + mission/gopsa_m"), 10, "no metric 'gopsa_m'; did you mean 'gospa_m'"),
        (("search", "--set", "direction=maximize"), 10, "search.direction: found 'maximize'; did you mean 'maximise'"),
        (("search", "--set", "sampler=TPF"), 10, "search.sampler: found 'TPF'; did you mean 'TPE'"),
        (("search", "--set", "ranges=n_adversaries=1..9"), 10, "9 of '1..9' is not possible"),
        (("delay", "--candidates", "3"), 10, "has no search, so no candidates"),
        (("search", "--candidates", "0"), 2, "--candidates"),
        (("rogue", "--candidates", "3"), 2, "expected no --candidates"),
    ],
)
def test_wrong_options_are_refused_before_anything_starts(
    mast, tmp_path: Path, words: tuple[str, ...], code: int, message: str
) -> None:
    ended, out, err = mast("study", *words)
    assert (ended, message in " ".join((out + err).split())) == (code, True), out + err
    assert "Traceback" not in err
    assert not (tmp_path / "runs").exists()


SECTION = dict(run="attacked", parameters={"false_positives": "0.0..5.0"}, objective="fp")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(search=3), "search: found 3, expected a dict with run, parameters, objective"),
        (dict(search=dict(run="attacked", objective="fp")), "search.parameters: missing"),
        (dict(search=SECTION | dict(candidate=3)), "search.candidate: unknown key; did you mean 'candidates'"),
        (dict(search=SECTION | dict(run="atacked")), "search.run: found 'atacked'; did you mean 'attacked'"),
        (dict(search=SECTION | dict(run="plain")), "search.run: 'plain' is the baseline, expected a run that attacks"),
        (dict(search=SECTION | dict(run="swept")), "search.run: 'swept' has a grid"),
        (dict(search=SECTION | dict(seeds=0)), "search.seeds: found 0, expected a whole number from 1"),
        (dict(search=SECTION | dict(batch=True)), "search.batch: found True, expected a whole number from 1"),
        (dict(search=SECTION, trials=None), "trials: missing, expected the number of seeds"),
        (dict(search=SECTION, security=["tls"]), "search: this study has `security` too, expected one of them"),
        (dict(search=SECTION, more=dict(searched=dict(scenario="baseline"))), "found the label 'searched'"),
    ],
)
def test_an_invalid_section_is_refused_by_name(tmp_path: Path, change: dict[str, object], message: str) -> None:
    runs = dict(
        plain=dict(scenario="baseline"),
        attacked=dict(scenario="uncoordinated"),
        swept=dict(scenario="uncoordinated", grid=dict(n_adversaries=[1, 2])),
    )
    runs |= change.pop("more", {})  # type: ignore[arg-type]
    content = dict(runs=runs, baseline="plain", trials=3) | change
    (tmp_path / "mine.py").write_text(f"def study():\n    return {content!r}\n")
    with pytest.raises(ConfigurationError) as raised:
        definition.load(str(tmp_path / "mine.py"))
    assert message in str(raised.value)


def test_the_shipped_search_is_valid_for_any_scenario_with_adversaries() -> None:
    shipped = definition.load("search")
    assert shipped.search is not None
    assert [each.label for each in shipped.configurations] == ["unattacked", "attacked"]
    settings = ["scenario=uncoordinated", "ranges=false_positives=0.5..5.0; region=in_view|ego_path", "n_adversaries=1"]
    other = definition.load("search", settings)
    assert other.search is not None
    assert other.configurations[1].settings == ("n_adversaries=1",)
    assert list(other.search.space) == ["false_positives", "region"]


def test_the_default_of_a_searched_parameter_is_that_of_the_attack_unless_the_study_has_another() -> None:
    ranges = "ranges=attack.speed_mps=0.0..15.0; attack.tolerance=0.01..0.3; budget=1.0..4.0"
    attack = "attack={'type': 'Collusion', 'tolerance': 0.2}"
    study = replace(definition.load("search", [ranges, attack, "scenes=intersection:8"]), frames=5)
    of_class = inspect.signature(Collusion).parameters["speed_mps"].default
    assert searching.defaults(study) == {"attack.speed_mps": of_class, "attack.tolerance": 0.2, "budget": 2.0}
