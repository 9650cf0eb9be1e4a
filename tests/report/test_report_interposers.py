"""Effects and reports of interposers: verdicts, live insertion, downlink."""

from typing import Any

import numpy as np
import pytest

from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.interposers import Interposer, adversaries_by_agent, all_wires, exit_expected, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.diagram import draw_wiring
from mast_zenoh.show.figures.style import svg
from mast_zenoh.show.findings.adversaries import attacks, effects, positions
from mast_zenoh.show.findings.causes import reaches
from mast_zenoh.show.findings.words import said
from mast_zenoh.show.html import environment
from mast_zenoh.show.tables.wiring import Spot, WireRow, layout, wire_rows

MEASURED = {"messages": 40, "effects": {"inserted": 3, "corrupted": 2}, "reports": 0, "agreement": "silent"}
MEASURED |= {"unreported": 5, "unfounded": 0, "role": "adversary", "wires": ["agent/infra_1/tracks"]}


def wire(key: str, chain: tuple[str, ...] = (), before: str = "") -> dict[str, Any]:
    publisher, *to = ("command_center", "ego", "infra_1") if key == "cc/picture" else ("infra_1", "broker")
    legs: list[dict[str, Any]] = [{"key": key, "from": publisher, "to": to}]
    if before:
        legs[0]["to"] = [chain[0], *(name for name in to if name != before)]
        legs.append({"key": f"{key}/@tap/{before}/0", "from": chain[0], "to": [before], "before": before})
    elif chain:
        legs = [{"key": f"{key}/@tap/0", "from": publisher, "to": [chain[0]]}, {"key": key, "from": chain[0], "to": to}]
    message = key.rpartition("/")[2]
    legs = [leg | {"from_port": message, "to_ports": [message for _ in leg["to"]]} for leg in legs]
    estimate = {"picture": "picture", "tracks": "local"}.get(message)
    ends = {"publisher": publisher, "subscribers": to, "subject": "infra_1" if message == "tracks" else ""}
    return {"estimate": estimate, "key": key, "message": message, "legs": legs, "interposers": list(chain)} | ends


def run_of(
    wires: list[dict[str, Any]],
    measured: dict[str, Any] | None = None,
    nodes: dict[str, Any] | None = None,
    interceptions: tuple[dict[str, Any], ...] = (),
) -> Run:
    roles = {"ego": "agent", "infra_1": "agent", "command_center": "command_center", "broker": "broker"}
    known = {name: {"role": role, "exit": 0, "ended": "ok"} for name, role in roles.items()} | (nodes or {})
    run = {"nodes": known, "interceptions": list(interceptions), "status": "ok"}
    metrics = {"interposers": measured or {}}
    scenario = {"nodes": {name: {"role": role} for name, role in roles.items()}}
    return Run.of(RunFiles(None, record=run, scenario=scenario, wiring={"wires": wires}, summary=metrics))


def only(run: Run) -> Interposer:
    (matches,) = interposers(run)
    return matches


def test_measured_effects_are_compared_with_reports() -> None:
    by_name = only(run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": MEASURED}))
    assert (by_name.verdict, by_name.reports_text, by_name.other, by_name.changed) == (
        "silent",
        "nothing",
        "2 corrupted",
        5,
    )
    lying = MEASURED | {"reports": 7, "agreement": "disagrees", "unreported": 1, "unfounded": 3}
    by_name = only(run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": lying}))
    assert by_name.reports_text == "7 (1 unreported, 3 unfounded)"


FAILURE = {"handler": "on_tracks", "count": 4, "frames": 4, "first_frame": 1, "last_frame": 4}
FAILURE |= {"exception": "ValueError: no", "where": "mine.py:3"}
ONCE = FAILURE | {"count": 1, "frames": 1, "last_frame": 1}
SIGKILL = "killed by the scenario; killed by signal 9 (SIGKILL)"


@pytest.mark.parametrize(
    ("node", "verdict", "words"),
    [
        ({"failures": [FAILURE], "exit": 0, "ended": "ok"}, "failed", "in 4 frames"),
        ({"failures": [ONCE], "exit": 0, "ended": "ok"}, "failed", "in 1 frame"),
        ({"failures": [], "exit": 1, "ended": "exit code 1"}, "crashed", "mallory crashed"),
        ({"exit": 1, "ended": f"{SIGKILL}; exit code 1"}, "crashed", "mallory crashed"),
        ({"exit": -9, "ended": SIGKILL}, "silent", ""),
        ({"exit": -15, "ended": "released; killed by signal 15 (SIGTERM)"}, "silent", ""),
        ({"exit": 0, "ended": f"{SIGKILL}; ok"}, "silent", ""),
    ],
)
def test_failures_and_crashes_but_no_intended_exits_take_precedence_over_reports(
    node: dict[str, Any], verdict: str, words: str
) -> None:
    run = run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": MEASURED}, {"mallory": node})
    assert only(run).verdict == verdict
    assert words in " ".join(said(run, attacks(run)))
    assert words or exit_expected(node)


def test_a_crash_states_how_often_a_handler_failed() -> None:
    for failure, words in (
        (FAILURE, "on_tracks failed 4 times in 4 frames (1 to 4)"),
        (ONCE, "on_tracks failed once in frame 1"),
        ({"handler": "tracks", "count": 1}, "tracks failed once"),
    ):
        nodes = {"mallory": {"failures": [failure]}}
        run = run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": MEASURED}, nodes)
        assert only(run).failures == words


def test_adversary_on_the_downlink_is_described_by_its_victim_alone() -> None:
    run = run_of([wire("cc/picture", ("mallory",), before="ego")], {"mallory": MEASURED | {"wires": ["cc/picture"]}})
    assert only(run).before == ("ego",)
    assert adversaries_by_agent(interposers(run)) == {"ego": ("mallory",)}
    assert [each.parts for each in positions(run)] == [(Finding("place", what="path", where="ego"),)]
    (row,) = wire_rows(run)
    assert row.before == {"mallory": ("ego",)}
    assert "<strong>mallory</strong> <small>(only before ego)</small>" in rendered_wires([row])
    assert "only before ego" in only(run).place
    on_trunk = run_of([wire("cc/picture", ("mallory",))])
    assert only(on_trunk).place == "cc/picture"
    assert [each.parts for each in positions(on_trunk)] == [(Finding("place", what="wire", where="cc/picture"),)]


def rendered_wires(rows: list[WireRow]) -> str:
    template = environment().from_string("{% import 'parts.html.j2' as parts %}{{ parts.wiring({}, rows) }}")
    return template.render(rows=rows)


def targets(adversary: str, kind: str, objects: list[int]) -> dict[str, Any]:
    n = len(objects)
    return {
        "adversary": np.full(n, adversary, object),
        "kind": np.full(n, kind, object),
        "object": np.array(objects),
        "frame": np.arange(n),
    }


@pytest.mark.parametrize(
    ("measured", "manipulated", "words"),
    [
        (
            {"inserted": 5, "moved": 3, "dropped": 2},
            None,
            "5 rows of objects inserted, 3 rows of objects moved, 2 messages dropped",
        ),
        (
            {"inserted": 5, "moved": 3, "dropped": 2},
            ("inserted", [7, 7, 7, 8, 8]),
            "5 rows of 2 objects inserted, 3 rows of objects moved, 2 messages dropped",
        ),
        ({"inserted": 1, "dropped": 1}, ("inserted", [7]), "1 row of 1 object inserted, 1 message dropped"),
        ({"removed": 3}, ("removed", [7, 7, -1]), "3 rows of 1 object and of clutter removed"),
        ({"removed": 3}, ("removed", [7, 7]), "3 rows of objects removed"),
    ],
)
def test_effects_distinguish_rows_objects_clutter_and_messages(
    measured: dict[str, int], manipulated: tuple[str, list[int]] | None, words: str
) -> None:
    """A row without target hides the number of objects."""
    run = run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": MEASURED | {"effects": measured}})
    if manipulated is not None:
        run.files.targets = targets("mallory", *manipulated)
    assert ", ".join(map(sentence, effects(only(run)))) == words


LIVE = {"action": "intercept", "node": "mallory", "wires": ["agent/infra_1/tracks"], "frame": 44}
RELEASE = {"action": "release", "node": "mallory", "wires": ["agent/infra_1/tracks"], "frame": 90}


def test_interposer_removed_during_the_run_is_named_and_drawn() -> None:
    run = run_of([wire("agent/infra_1/tracks")], {"mallory": MEASURED}, interceptions=(LIVE, RELEASE))
    by_name = only(run)
    assert (by_name.live, by_name.released) == (44, 90)
    assert "in frames 44 to 89" in by_name.description
    (row,) = wire_rows(run)
    assert row.intercepted
    assert row.when == {"mallory": "frames 44 to 89"}
    plan = layout(run)
    assert Spot("mallory", after=1) in plan.places
    figure = draw_wiring(run)
    assert "frames 44 to 89" in {text.get_text() for text in figure.axes[0].texts}
    assert b"<svg" in svg(figure)


def test_interposer_before_one_subscriber_that_was_removed_is_on_the_way_to_that_one_alone() -> None:
    live = LIVE | {"wires": ["cc/picture"], "before": "infra_1"}
    measured = {"mallory": MEASURED | {"wires": ["cc/picture"]}}
    run = run_of(
        [wire("cc/picture", ("silent",), before="infra_1")],
        measured,
        interceptions=(live, RELEASE | {"wires": ["cc/picture"]}),
    )
    (only_wire,) = all_wires(run)
    assert only_wire["interposers"] == ["silent", "mallory"]
    assert [(leg["from"], leg["to"]) for leg in only_wire["legs"] if "before" in leg] == [
        ("silent", ["mallory"]),
        ("mallory", ["infra_1"]),
    ]
    assert reaches(run, "mallory", "picture_received", "infra_1")
    assert not reaches(run, "mallory", "picture_received", "ego")


def test_live_interposer_that_remains_is_drawn_once() -> None:
    run = run_of([wire("agent/infra_1/tracks", ("mallory",))], {"mallory": MEASURED}, interceptions=(LIVE,))
    (only_wire,) = all_wires(run)
    assert only_wire["interposers"] == ["mallory"]
    assert wire_rows(run)[0].when == {"mallory": "from frame 44"}


def test_links_come_last_and_are_not_adversaries() -> None:
    link = MEASURED | {"role": "link", "effects": {"dropped": 9}}
    chain = wire("agent/infra_1/tracks", ("link_1",))
    chain["interposers"].append("mallory")
    run = run_of([chain], {"link_1": link, "mallory": MEASURED})
    assert [each.name for each in interposers(run)] == ["mallory", "link_1"]
    assert adversaries_by_agent(interposers(run)) == {"infra_1": ("mallory",)}
