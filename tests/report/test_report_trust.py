"""The report shows the command centre's trust: states, withheld objects, suspensions and their reasons."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from kept_texts import assert_kept
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle
from rich.console import Console
from run_samples import edit
from table_writing import write_table

from mast_zenoh.runs.events import (
    fault_spans,
    happenings,
    judged_agents,
    lie_spans,
    spans,
    state_spans,
    states_at,
    withheld_at,
)
from mast_zenoh.runs.run import Run
from mast_zenoh.show import terminal
from mast_zenoh.show.figures.drawing import birdseye_figure
from mast_zenoh.show.figures.plots import trust_over_time
from mast_zenoh.show.figures.style import png
from mast_zenoh.show.figures.view import frame_view
from mast_zenoh.show.film import takes
from mast_zenoh.show.film.takes import Take
from mast_zenoh.show.findings.causes import causes
from mast_zenoh.show.findings.changes import MISSED, Change
from mast_zenoh.show.findings.defence import of_defence, periods
from mast_zenoh.show.findings.words import said
from mast_zenoh.show.palette import STATES, WITHHELD
from mast_zenoh.show.tables.of_run import (
    suspension_table,
    undecided_table,
)

AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
FRAMES, DETECTED, FAULTY = 40, 20, 25
REASON = "reports objects in free space"


def seconds(trusted: float, suspended: float) -> dict[str, float]:
    return {"unknown": 0.0, "trusted": trusted, "faulty": 0.0, "suspended": suspended}


def of_agent(**changes: Any) -> dict[str, Any]:
    """The entry of an honest agent in metrics.json, changed."""
    honest = dict(lied=False, first_lie_s=None, suspended_after_s=None, observed_s=None, suspensions=[])
    return honest | changes


def suspension(from_s: float, until_s: float | None, conduct: str) -> dict[str, Any]:
    return dict(from_s=from_s, until_s=until_s, reason=REASON, conduct=conduct)


INTEGRITY: dict[str, Any] = {
    "agents": {
        "ego": of_agent(),
        "infra_1": of_agent(
            lied=True,
            first_lie_s=1.5,
            suspended_after_s=0.5,
            observed_s=0.5,
            suspensions=[suspension(2.0, 3.0, "lying"), suspension(3.5, None, "lying")],
        ),
        "infra_2": of_agent(suspensions=[suspension(1.0, 1.2, "honest")]),
        "infra_3": of_agent(lied=True, first_lie_s=1.5, observed_s=2.4),
        "infra_4": of_agent(),
    },
    "seconds": {"honest": seconds(14.0, 0.2), "faulty": seconds(0.0, 0.0), "lying": seconds(3.4, 1.4)},
    "honest_suspended": ["infra_2"],
    "false_alarms": 1,
    "withheld": {"true": 0.25, "false": 1.5},
}


def judged(path: Path) -> Path:
    """A run with adversaries on infra_1 and infra_3; infra_1 is suspended from frame 20, infra_4 faulty from 25."""
    frame, agent = np.repeat(np.arange(FRAMES), 5), np.tile(np.array(AGENTS, object), FRAMES)
    suspended = (agent == "infra_1") & (frame >= DETECTED)
    faulty = (agent == "infra_4") & (frame >= FAULTY)
    state = np.where(suspended, "suspended", np.where(faulty, "faulty", "trusted")).astype(object)
    columns = dict(frame=frame, time_s=frame * 0.1, agent=agent, mean=np.where(suspended, 0.1, 0.9), state=state)
    columns |= dict(log_odds=np.where(suspended, -2.0, 2.0))
    write_table(path / "trust.parquet", columns | dict(reason=np.where(suspended, REASON, "").astype(object)))
    boxes = {name: np.full(FRAMES, value) for name, value in dict(l=6.0, w=4.0, h=1.5, z=0.75, yaw=0.0).items()}
    place = dict(x=np.full(FRAMES, -30.0), y=np.full(FRAMES, -40.0), withheld=np.arange(FRAMES) >= DETECTED)
    frames = dict(frame=np.arange(FRAMES), id=np.full(FRAMES, 7))
    write_table(path / "trust_objects.parquet", frames | boxes | place)
    faults = {"infra_4": [["BlindSector", 2.5, None], ["Loss", 0.5, 1.0]]}
    evaluator = {"nodes": {"evaluator": {"config": {"faults": faults}}}}
    return edit(path, metrics={"integrity": INTEGRITY}, scenario=evaluator)


@pytest.fixture
def folder(run_folder: Callable[..., Path]) -> Path:
    return judged(run_folder("uncoordinated"))


def pixels(picture: bytes, colour: str) -> int:
    image = np.asarray(matplotlib.image.imread(io.BytesIO(picture)))[..., :3]
    return int((np.abs(image - to_rgb(colour)) < 0.02).all(axis=-1).sum())


def test_the_state_of_an_agent_is_that_of_the_latest_message(folder: Path) -> None:
    run = Run(folder)
    assert judged_agents(run) == list(AGENTS)
    assert states_at(run, DETECTED - 1) == dict.fromkeys(AGENTS, "trusted")
    assert states_at(run, FRAMES + 10) == dict.fromkeys(AGENTS, "trusted") | {
        "infra_1": "suspended",
        "infra_4": "faulty",
    }


def test_spans_are_periods_of_a_state_and_of_faults(folder: Path) -> None:
    run = Run(folder)
    rows = {name: column[run.files.trust["agent"] == "infra_1"] for name, column in run.files.trust.items()}
    assert state_spans(rows, "suspended", 4.0) == [(2.0, 4.0)]
    assert state_spans(rows, "trusted", 4.0) == [(0.0, 2.0)]
    assert fault_spans(run, "infra_4", 4.0) == [("BlindSector", 2.5, 4.0), ("Loss", 0.5, 1.0)]
    assert fault_spans(run, "ego", 4.0) == []


def test_lies_are_the_measured_changes_on_an_agents_own_wires(folder: Path) -> None:
    run = Run(folder)
    wire = np.where(run.manipulations["interposer"] == "adversary_1", "agent/infra_1/tracks", "cc/picture")
    run.manipulations["wire"] = wire.astype(object)
    ((start, end),) = lie_spans(run, "infra_1")
    assert (start, end) == pytest.approx((1.5, 3.9), abs=0.11)
    assert lie_spans(run, "infra_3") == [], "a change of the picture is no lie of an agent"


def test_agents_have_the_colour_of_their_state_and_withheld_objects_are_outlined(folder: Path) -> None:
    run = Run(folder)
    assert len(withheld_at(run, DETECTED)) == 1
    assert len(withheld_at(run, DETECTED - 1)) == 0
    views = [frame_view(run, frame) for frame in (DETECTED - 1, FAULTY + 1)]
    before, after = (png(birdseye_figure(view)) for view in views if view is not None)
    assert pixels(before, STATES["suspended"]) == pixels(before, STATES["faulty"]) == 0
    assert pixels(after, STATES["suspended"]) > 50
    assert pixels(after, STATES["faulty"]) > 50
    assert pixels(after, WITHHELD) > pixels(before, WITHHELD)


def test_suspended_relays_of_honest_agents_are_named_with_those_whose_agents_were_deceived(
    run_folder: Callable[..., Path],
) -> None:
    def relayed(deceived: bool, conduct: str = "honest") -> dict[str, Any]:
        return dict(suspensions=[suspension(1.0, None, conduct) | dict(deceived=deceived)])

    agents = {"ego": relayed(True, "lying"), "infra_2": relayed(False), "infra_4": relayed(True)}
    relays = dict(agents=agents, honest_suspended=["infra_2", "infra_4"], false_alarms=2)
    path = edit(run_folder("uncoordinated"), metrics={"integrity": INTEGRITY | {"relays": relays}})
    run = Run(path)
    (found,) = (each for each in of_defence(run) if each.kind == "relays")
    assert (found.who, found.value, found.cause) == (("infra_2", "infra_4"), 2, ("infra_4",))


def test_the_chart_has_a_row_for_each_agent_with_its_suspensions_and_faults(folder: Path) -> None:
    figure = trust_over_time(Run(folder), 33)
    assert [axes.get_ylabel() for axes in figure.axes] == list(AGENTS)

    def spans(index: int) -> list[tuple[float, float]]:
        patches = [patch for patch in figure.axes[index].patches if isinstance(patch, Rectangle)]
        return [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in patches]

    assert spans(0) == []
    assert spans(1) == [pytest.approx((2.0, 4.0)), pytest.approx((1.5, 4.0))], "suspended, and lying"
    assert spans(4) == [pytest.approx((2.5, 4.0)), pytest.approx((2.5, 4.0)), pytest.approx((0.5, 1.0))]
    assert [text.get_text() for text in figure.axes[4].texts] == ["BlindSector", "Loss"]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["trust, 0 to 1", "taken to be faulty", "suspended", "lies", "is faulty", "frame shown"]


def test_every_suspension_has_a_row_with_its_reason(folder: Path) -> None:
    table = suspension_table(Run(folder))
    assert table.lines == [
        ("infra_2", "1.0", "1.2", "honest", "\u2013", REASON),
        ("infra_1", "2.0", "3.0", "lying", "0.5", REASON),
        ("infra_1", "3.5", "end", "lying", "\u2013", REASON),
    ]
    assert table.bad == [True, False, False]


def test_an_agent_whose_suspension_flickers_has_one_line(folder: Path) -> None:
    flicker = [suspension(0.5 * at, 0.5 * at + 0.2, "honest" if at < 4 else "lying") for at in range(5)]
    agents = {"infra_2": of_agent(suspensions=[*flicker, suspension(3.5, None, "lying")])}
    edit(folder, metrics={"integrity": {"agents": agents}})
    run = Run(folder)
    (found,) = (each for each in periods(run) if each.who == ("infra_2",))
    assert said(run, [found]) == [
        f"The command centre suspended infra_2 (honest) from 0.0 s to 0.2 s, 6 times in all: {REASON}"
    ]


def line_on(folder: Path, defence: str, integrity: dict[str, Any]) -> str:
    """What the terminal prints of a defence of which this was measured, or else last."""
    centre = {"command_center": {"config": {"pipeline": {"integrity": {"type": defence}}}}}
    edit(folder, scenario={"nodes": centre}, metrics={"integrity": lambda _: integrity})
    page = io.StringIO()
    terminal.show_run(Console(file=page, width=1000), folder)
    lines = page.getvalue().splitlines()
    return next((line for line in lines if line.startswith(f"{defence}:")), lines[-1])


NOTHING = {"agents": {"ego": of_agent()}, "withheld": {"true": 0.0, "false": 0.0}}
EARLY = of_agent(lied=True, first_lie_s=1.5, suspensions=[suspension(0.0, None, "honest")])
CORRECTED = of_agent(seconds={"honest": {"trusted": 3.0, "faulty": 1.25}, "faulty": {"faulty": 2.0}})
ALARM = of_agent(suspensions=[suspension(1.0, None, "honest")])
DEFENCES: list[tuple[str, dict[str, Any]]] = [
    ("FreeSpace", {}),
    ("Robosac", {"agents": {"infra_1": EARLY}}),
    ("FreeSpace", NOTHING),
    ("FaultOrLie", NOTHING | {"agents": {"ego": CORRECTED, "infra_1": of_agent()}}),
    ("KOfN", {"agents": {f"infra_{number}": ALARM for number in range(15)}}),
    ("NoIntegrity", {}),
]


def test_a_line_says_which_agents_the_defence_suspended_when_and_what_it_withheld(folder: Path) -> None:
    assert_kept("defence_of_a_run", *(line_on(folder, name, INTEGRITY | changes) for name, changes in DEFENCES))


#: As long as the names of possible liars make it.
OPEN = (
    "denies 3 objects of infra_4 and infra_2, which deny it in turn: it lies, or both of them lie, or infra_1 lies "
    "with one of them; possible liars: infra_1, infra_2, infra_3, infra_4"
)


def doubted(folder: Path) -> Path:
    """The run, with infra_2 and infra_3 undecided: the first from frame 10 to the end, the second up to frame 20."""
    run = Run(folder)
    agent, frame = run.files.trust["agent"], run.files.trust["frame"]
    rows = ((agent == "infra_2") & (frame >= 10)) | ((agent == "infra_3") & (frame >= 10) & (frame < 20))
    state = np.where(rows, "undecided", run.files.trust["state"]).astype(object)
    reason = np.where(rows, OPEN, run.files.trust["reason"]).astype(object)
    write_table(folder / "trust.parquet", run.files.trust | dict(state=state, reason=reason))
    agents = INTEGRITY["agents"] | {
        "infra_2": of_agent(undecided=[suspension(1.0, None, "honest") | {"reason": OPEN}]),
        "infra_3": INTEGRITY["agents"]["infra_3"] | {"undecided": [suspension(1.0, 2.0, "honest") | {"reason": OPEN}]},
    }
    part = INTEGRITY | {"agents": agents, "honest_suspended": [], "false_alarms": 0}
    return edit(folder, metrics={"integrity": lambda _: part})


@pytest.fixture
def undecided(folder: Path) -> Path:
    return doubted(folder)


def test_undecided_agents_have_a_colour_and_their_state_below_the_name(undecided: Path) -> None:
    view = frame_view(Run(undecided), FAULTY + 1)
    figure = birdseye_figure(view)
    assert pixels(png(figure), STATES["undecided"]) > 50
    assert "infra_2\nundecided" in {text.get_text() for axes in figure.axes for text in axes.texts}


def test_the_chart_shows_when_an_agent_was_undecided(undecided: Path) -> None:
    figure = trust_over_time(Run(undecided), None)
    (patch,) = (patch for patch in figure.axes[2].patches if isinstance(patch, Rectangle))
    assert (patch.get_x(), patch.get_width()) == pytest.approx((1.0, 3.0))
    assert "undecided" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_undecided_period_has_a_row_and_a_line_with_its_whole_reason(undecided: Path) -> None:
    run = Run(undecided)
    found = [(each.who, each.when, each.cause) for each in periods(run) if each.what == "undecided"]
    assert found == [(("infra_2",), (1.0, 4.0), ("honest", OPEN)), (("infra_3",), (1.0, 2.0), ("honest", OPEN))]
    agents = run.files.summary["integrity"]["agents"]
    agents["infra_3"]["undecided"] = [suspension(2.5, None, "honest") | {"reason": OPEN}]
    assert undecided_table(run).lines[-1][3] == "honest, lied before"


def test_the_events_of_a_run_say_who_the_possible_liars_are(undecided: Path) -> None:
    run = Run(undecided)
    times = np.arange(FRAMES) * 0.1
    periods = spans(run, times)
    assert [(each["label"], each["from_s"], each["until_s"]) for each in periods if each["kind"] == "undecided"] == [
        ("infra_2 undecided", 1.0, 4.0),
        ("infra_3 undecided", 1.0, 2.0),
    ]
    texts = [each.text for each in happenings(run, periods, times) if each.kind == "undecided"]
    assert f"infra_2 lies: {OPEN}" in " ".join(texts)
    assert "no longer undecided" in " ".join(texts)


def test_the_caption_of_a_film_names_undecided_agents_in_one_line(undecided: Path) -> None:
    take = Take(Run(undecided), "picture")
    captions = [text for frame, text in takes.caption_events(take) if frame == 10]
    assert captions == ["infra_2 undecided", "infra_3 undecided"]


@pytest.mark.parametrize(
    ("reporters", "suspended", "number"),
    [
        (("infra_2", "infra_3", "infra_4"), (), "1.0"),
        (("infra_2+infra_3", "infra_2", "infra_4"), ("infra_2",), "0.7"),
        (("infra_2", "infra_2+infra_3", "infra_3"), ("infra_2", "infra_3"), "0.0"),
        (("ego+infra_2", "infra_2+infra_3", "infra_3+infra_4"), (), "2.0"),
    ],
)
def test_the_cause_counts_the_agents_that_reported_each_withheld_object(
    folder: Path, reporters: tuple[str, ...], suspended: tuple[str, ...], number: str
) -> None:
    run = Run(folder)
    objects, trust = run.files.objects, run.files.trust
    rows = np.flatnonzero((objects["estimator"] == "picture") & (objects["frame"] == FAULTY))[: len(reporters)]
    for name, values in (("cause", "withheld"), ("by", reporters)):
        objects[name] = objects[name].astype(object)
        objects[name][rows] = values
    trust["state"][np.isin(trust["agent"], suspended)] = "suspended"
    change = Change("ego", "picture", MISSED, 1.0, 1.0, {"withheld": 1.0})
    assert f"average {number} agents" in causes(run, change)[-1]
