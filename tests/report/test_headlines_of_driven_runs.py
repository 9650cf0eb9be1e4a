"""The headline of a run with drivers begins with what happened to its cars, and credits nothing to their other way."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from browser import chromium
from test_report_of_driven_cars import BRAKED, HIT, course, happened

from mast_zenoh.run_folder.finding import sentence
from mast_zenoh.runs.events import first_changes
from mast_zenoh.runs.interposers import interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference, same_ways
from mast_zenoh.show.findings import found_in, headline, of_compared, outcome
from mast_zenoh.show.findings.adversaries import attacks, effects, limits
from mast_zenoh.show.findings.cars import worst
from mast_zenoh.show.findings.words import text
from mast_zenoh.show.html import write_page

pytestmark = pytest.mark.usefixtures("without_figures")

RunOf = Callable[..., Run]
Driven = Callable[..., tuple[Run, Reference]]
_WIDTHS = """() => [...document.querySelectorAll(".scroll")].map((box) => [box.scrollWidth, box.clientWidth])"""
_WRAPPED = """() => getComputedStyle(document.querySelector("#driving ~ .scroll td.num")).whiteSpace"""


@pytest.fixture
def driven(run_of: RunOf) -> Driven:
    """A run with the given consequences for its ego, and its twin; stops: whether it goes another way."""

    def pair(*, stops: bool = False, twin: dict[str, Any] | None = None, **changes: Any) -> tuple[Run, Reference]:
        run, other = run_of("uncoordinated"), run_of()
        run.files.driven = course(hard=stops)
        other.files.driven = course(hard=False)
        run.files.summary["driven"] = {"ego": happened(**changes)}
        other.files.summary["driven"] = {"ego": happened(**(twin or {}))}
        return run, Reference(other, "unattacked")

    return pair


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"collisions": [HIT, HIT], "needless_brakes": 2}, "The ego hits 2 objects (unattacked: 0)"),
        ({"needless_brakes": 1}, "The ego brakes needlessly 1 time (unattacked: 0)"),
        ({"progress_m": 52.4}, "The ego drives 52 m (unattacked: 93 m)"),
        (
            {"needless_brakes": 3, "progress_m": 8.0},
            "The ego brakes needlessly 3 times (unattacked: 0). The ego drives 8 m (unattacked: 93 m)",
        ),
        ({"progress_m": 92.5}, ""),
    ],
)
def test_collisions_or_else_needless_brakes_and_the_way_come_before_errors(
    changes: dict[str, Any], words: str, driven: Driven, run_of: RunOf
) -> None:
    run, twin = driven(**changes)
    without_drivers = headline(run_of("uncoordinated"), Reference(run_of(), "unattacked"))
    assert text(run, worst(run, twin)) == words
    assert headline(run, twin) == (f"{words}. {without_drivers}" if words else without_drivers)
    for damaged in (7, [None], {"ego": 7}, {"ego": {"collisions": 1}}, {"ego": {"progress_m": "far"}}):
        run.files.summary["driven"] = damaged
        assert worst(run, twin) == []


def test_errors_of_a_car_elsewhere_are_attributed_by_the_run_alone(driven: Driven) -> None:
    run, twin = driven(stops=True, **{key: BRAKED[key] for key in ("needless_brakes", "progress_m")})
    assert not same_ways(run, twin.run)
    (own,) = (each for each in outcome(run) if each.kind == "change")
    assert own.cause == ("adversary_1", "adversary_2")
    assert own in outcome(run, twin)
    assert (outcome(run, twin)[-1].kind, outcome(run, twin)[-1].what) == ("unattributed", "way")
    assert found_in(run, twin)["details"] == found_in(run)["details"]
    assert limits(run, twin) == limits(run)


def test_no_attack_is_blamed_for_errors_that_come_from_the_changed_way(run_of: RunOf, driven: Driven) -> None:
    _, twin = driven()
    run = run_of()
    run.files.driven = course(hard=True)
    run.files.summary["driven"] = {"ego": happened(progress_m=29.0)}
    run.files.summary["agents"]["ego"]["picture"]["fp"]["mean"] += 5.0
    told = outcome(run, twin)
    assert [(each.kind, each.what) for each in told] == [("car", "way"), ("missed", ""), ("unattributed", "way")]
    assert (told[0].value, told[0].other, told[0].than) == (29.0, 93.0, "unattacked")


def test_a_car_whose_course_is_not_known_counts_as_elsewhere(driven: Driven) -> None:
    run, twin = driven()
    assert same_ways(run, twin.run)
    run.files.driven = None
    assert not same_ways(run, twin.run)
    del run.files.summary["driven"]
    assert not same_ways(run, twin.run)
    del twin.run.files.summary["driven"]
    assert same_ways(run, twin.run)


def test_the_headline_of_compared_runs_begins_with_the_worst_that_happened(driven: Driven) -> None:
    run, twin = driven(stops=True, collisions=[HIT], progress_m=40.0)
    slow, _ = driven(progress_m=10.0)
    runs = {"unattacked": twin.run, "slow": slow, "hit": run}
    title, sentences = of_compared(runs, Reference(twin.run, "unattacked"))
    assert title == f"hit: {headline(run, twin)}"
    assert any(each.startswith(title) for each in sentences)


def test_braking_by_the_rule_is_not_told_as_what_the_driver_did(driven: Driven) -> None:
    run, twin = driven()
    shares = {"needless_brake_share": 0.59, "needless_brake_share_attack": 0.59, "missed_brake_share": 0.2}
    run.files.summary["driving"] = {"ego": {"mission": shares}}
    twin.run.files.summary["driving"] = {"ego": {"mission": dict.fromkeys(shares, 0.0)}}
    assert not [each for each in found_in(run, twin)["details"] if each.kind == "braking"]
    page = write_page(run, reference=twin).read_text()
    section = page.partition('<h2 id="driving">')[2]
    assert section.startswith("What it would")
    assert "59.0% by attack" in section, "the table still has it"
    del run.files.summary["driven"], twin.run.files.summary["driven"]
    (braking,) = (each for each in found_in(run, twin)["details"] if each.kind == "braking")
    assert (braking.what, braking.value) == ("needless", 0.59)
    assert '<h2 id="driving">What it would mean for driving</h2>\n<div' in write_page(run, reference=twin).read_text()


@pytest.mark.heavy
def test_the_tables_of_a_driven_run_fit_a_screen_of_1400_px(driven: Driven) -> None:
    run, twin = driven()
    shares = {f"{kind}_brake_share{by}": 0.448 for kind in ("needless", "missed") for by in ("", "_attack")}
    names = ("corridor_objects", "corridor_false", "corridor_missed", "overlapping_objects", "min_ttc_s", "brake_share")
    summary = dict.fromkeys(names, 1.25) | shares
    estimates = ("truth", "local", "mission")
    run.files.summary["driving"] = {"ego": dict.fromkeys(estimates, summary)}
    twin.run.files.summary["driving"] = {"ego": dict.fromkeys(estimates, dict.fromkeys(summary, 0.0))}
    page_file = write_page(run, reference=twin)
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(page_file.as_uri())
        tables = page.evaluate(_WIDTHS)
        assert len(tables) > 4
        assert [table for table in tables if table[0] > table[1]] == []
        assert page.evaluate(_WRAPPED) == "normal", "its numbers are wrapped before the bracket"


def test_only_braking_by_the_rule_differs(driven: Driven, run_of: RunOf) -> None:
    _, twin = driven()
    run = run_of()
    run.files.summary["driven"] = twin.run.files.summary["driven"]
    run.files.driven = course(hard=False)
    run.files.summary["driving"] = {"ego": {"mission": {"needless_brake_share_attack": 0.5}}}
    twin.run.files.summary["driving"] = {"ego": {"mission": {"needless_brake_share_attack": 0.0}}}
    assert [(each.kind, each.what) for each in outcome(run, twin)] == [("unchanged", "driving"), ("missed", "")]


def test_what_the_ego_acts_on_is_not_said_to_be_the_same_if_its_errors_are_as_many(
    driven: Driven, run_of: RunOf
) -> None:
    _, twin = driven()
    run = run_of()
    run.files.summary["driven"] = twin.run.files.summary["driven"]
    run.files.driven = course(hard=False)
    ego = run.files.summary["agents"]["ego"]
    twin.run.files.summary["agents"]["ego"]["picture_received"] = deepcopy(ego["picture"])
    ego["picture_received"] = deepcopy(ego["picture"])
    ego["picture_received"]["fp"]["mean"] += 4.0
    assert ("unchanged", "mission") in [(each.kind, each.where) for each in outcome(run, twin)]


@pytest.mark.parametrize("number", [1, 25])
def test_changed_commands_have_words_of_their_own(number: int, driven: Driven) -> None:
    run, twin = driven(stops=True, progress_m=29.0)
    run.files.summary["agents"] = twin.run.files.summary["agents"]
    wire = {"key": "agent/ego/command", "message": "command", "subject": "ego", "interposers": ["adversary_1"]}
    run.files.wiring["wires"] = [wire]
    run.files.summary["interposers"]["adversary_1"] |= {"effects": {"reframed": number}, "wires": [wire["key"]]}
    table = run.files.effects
    own = table["interposer"] == "adversary_1"
    table["message"] = np.where(own, "command", table["message"]).astype(object)
    table["wire"] = np.where(own, "agent/ego/command", table["wire"]).astype(object)
    table["effect"] = np.where(own, "reframed", table["effect"]).astype(object)
    (adversary,) = (each for each in interposers(run) if each.name == "adversary_1")
    assert [sentence(each) for each in effects(adversary)] == [f"{number} command{'s' * (number > 1)} changed"]
    assert attacks(run)[0].where == "agent/ego/command"
    assert adversary.other == f"{number} commands changed"
    columns = ("adversary", "kind", "object", "frame", "error_m_centre", "error_m_ego")
    run.files.targets = dict.fromkeys(columns, np.zeros(0))
    assert ("adversary_1",) not in [each.who for each in limits(run)], "what commands do is not in errors"
    assert "adversary_1 changes" in " ".join(event.text for event in first_changes(run))
