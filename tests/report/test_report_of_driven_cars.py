"""A report says what a driven car did and why, beside its twin: sentences, table, figure and page."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kept_texts import assert_kept
from matplotlib.figure import Figure
from page_blocks import unpack
from run_samples import FRAMES
from table_writing import write_table

from mast_zenoh.run_folder.finding import sentence
from mast_zenoh.runs.driven import course_of, happened_to, twin_course
from mast_zenoh.runs.files import Table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.figures.driven import driven_figure
from mast_zenoh.show.figures.style import THEMES
from mast_zenoh.show.figures.view import Window
from mast_zenoh.show.film.sheet import DriveMarks
from mast_zenoh.show.film.takes import Captions, Take
from mast_zenoh.show.findings.cars import of_cars
from mast_zenoh.show.findings.words import said
from mast_zenoh.show.html import write_report
from mast_zenoh.show.page.block import run_block
from mast_zenoh.show.palette import RUN_COLOURS
from mast_zenoh.show.tables.of_run import driven_table

RunOf = Callable[..., Run]
GHOST = {"object": 28, "kind": "false", "adversary": "adversary_1"}


def happened(**changes: Any) -> dict[str, Any]:
    """The consequences of a drive in which nothing happened, with changes."""
    return {
        "collisions": [],
        "near_misses": 0,
        "min_ttc_s": None,
        "rss_unsafe_s": 0.0,
        "brakes": [],
        "needless_brakes": 0,
        "missed_brakes": 0,
        "hardest_braking_mps2": 0.0,
        "progress_m": 93.0,
        "standing_s": 0.0,
        "behind": {"cars": 0, "hard_brakes": 0},
        **changes,
    }


def brake(cause: dict[str, Any], needless: bool = True) -> dict[str, Any]:
    return {"from_s": 1.7, "until_s": 2.1, "hardest_mps2": 9.0, "needless": needless, "cause": cause}


BRAKED = happened(brakes=[brake(GHOST)], needless_brakes=1, hardest_braking_mps2=9.0, progress_m=29.0, standing_s=1.1)


def course(hard: bool) -> Table:
    """The course of a car on a straight road, of which one brakes."""
    frame = np.arange(FRAMES)
    during = (frame >= 17) & (frame < 21) & hard
    speed = 8.0 - 0.9 * np.cumsum(during)
    return {
        "agent": np.full(FRAMES, "ego", object),
        "frame": frame,
        "time_s": 0.1 * frame,
        "x": -70.0 + np.cumsum(0.1 * speed),
        "y": np.full(FRAMES, -3.0),
        "heading": np.zeros(FRAMES),
        "speed_mps": speed,
        "acceleration_mps2": np.where(during, -9.0, 0.0),
        "brake": during,
    }


@pytest.fixture
def both(run_of: RunOf) -> tuple[Run, Reference]:
    """A run in which a ghost makes the ego brake, and its twin."""
    run, twin = run_of("uncoordinated"), run_of()
    run.files.driven = course(hard=True)
    twin.files.driven = course(hard=False)
    run.files.summary["driven"], twin.files.summary["driven"] = {"ego": BRAKED}, {"ego": happened()}
    return run, Reference(twin, "unattacked")


def told(run: Run, reference: Reference | None = None) -> list[str]:
    return said(run, of_cars(run, reference))


def test_findings_name_the_moment_the_object_and_the_adversary_of_a_brake(both: tuple[Run, Reference]) -> None:
    run, twin = both
    brake, *counts = of_cars(run, twin)
    assert (brake.kind, brake.what, brake.value, brake.when) == ("brake", "needless", 9.0, (1.7, 2.1))
    assert said(run, [brake])[0].endswith("(track 28, shown by adversary_1)")
    assert [(each.what, each.value, each.other) for each in counts] == [("way", 29.0, 93.0), ("stands", 1.1, 0.0)]
    assert [line.partition("ego ")[2] for line in told(run)[-2:]] == ["drives 29 m", "stands for 1.1 s"]
    del run.files.summary["driven"]
    assert of_cars(run, twin) == []


HIT = {"object": 9, "frame": 33, "speed_mps": 2.34, "hidden": True}
SEEN = happened(progress_m=50.0, collisions=[HIT | {"hidden": False}])
MANY = {f"mobile_{number}": happened(progress_m=100.0) for number in range(1, 18)}
KINDS = [
    *(("real", None, False), ("real", "liar", True), ("false", None, True), ("line", None, False)),
    *(
        ("no command", None, True),
        ("no command", "seizer", True),
        ("no estimate", None, True),
        ("none", "seizer", True),
    ),
    *(("unknown", None, True), ("none", None, True), ("none", None, False)),
]


def caused(kind: str, adversary: str | None, needless: bool) -> dict[str, Any]:
    return brake({"object": 28, "kind": kind, "adversary": adversary}, needless)


def in_order() -> list[dict[str, Any]]:
    """Brakes for ghosts and for what is there, the hardest first."""
    kinds = [
        ("false", "adversary_1"),
        ("real", None),
        ("real", "liar"),
        *[("false", "adversary_1")] * 4,
        ("none", None),
    ]
    needless = [number in (3, 4, 5, 7) for number in range(8)]
    return [
        caused(*kind, need) | {"hardest_mps2": 9.0 - number, "from_s": 2.0 + number}
        for number, (kind, need) in enumerate(zip(kinds, needless, strict=True))
    ]


CARS: dict[str, dict[str, Any]] = {
    "a collision": {"ego": happened(collisions=[HIT], missed_brakes=2)},
    "many cars": MANY | {"mobile_9": SEEN, "ego": happened()},
    "several that hit something": MANY | dict.fromkeys(("mobile_1", "mobile_2", "mobile_3", "mobile_9"), SEEN),
    "brakes for ghosts though the truth gave a reason too": {"ego": happened(brakes=in_order(), needless_brakes=4)},
}


def test_what_happened_to_cars_is_told_collisions_first(both: tuple[Run, Reference]) -> None:
    run, twin = both
    run.files.summary["driven"] = {"ego": happened(brakes=[caused(*each) for each in KINDS])}
    brakes = [sentence(replace(each, when=None, other=None)) for each in happened_to(run, "ego")]
    reasons = [each.partition("m/s² ")[2] for each in brakes]
    lines = [
        f"{kind} by {by}, {needless}: {reason}" for (kind, by, needless), reason in zip(KINDS, reasons, strict=True)
    ]
    for name, cars in CARS.items():
        run.files.summary["driven"] = cars
        lines += [f"{name}:", *told(run, twin if len(cars) == 1 else None), ""]
    assert_kept("cars", *lines)


def test_the_table_has_a_line_for_the_run_and_one_for_its_twin(both: tuple[Run, Reference]) -> None:
    run, twin = both
    rows = driven_table(run, twin.run, twin.name).lines
    assert [row[:2] for row in rows] == [("ego", "unattacked"), ("ego", run.name)]
    assert [row[4:8] for row in rows] == [("0", "0", "0", "0.0"), ("1", "1", "0", "9.0")]
    assert [row[10:12] for row in rows] == [("93.0", "0.0"), ("29.0", "1.1")]
    assert driven_table(twin.run).lines[0][0] == "ego"


def test_the_figure_shows_the_speeds_of_both_and_the_needless_brake_as_a_band(
    both: tuple[Run, Reference],
) -> None:
    run, twin = both
    figure = driven_figure(run, twin)
    _, acceleration, speed = figure.axes
    lines = {line.get_label(): line for line in speed.get_lines()}
    own = lines[f"ego, {run.name}"]
    assert own.get_color() == RUN_COLOURS[0]
    np.testing.assert_array_equal(own.get_ydata(), course(hard=True)["speed_mps"])
    np.testing.assert_array_equal(lines["unattacked"].get_ydata(), course(hard=False)["speed_mps"])
    bands = {patch.get_label(): patch.get_extents() for patch in acceleration.patches}
    assert {"attack", "brakes needlessly"} <= bands.keys()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["attack", "brakes needlessly", "unattacked", f"ego, {run.name}", "hard braking"]


@pytest.mark.usefixtures("without_figures")
def test_a_run_without_drivers_has_neither_a_figure_nor_a_section(run_of: RunOf) -> None:
    run = run_of("uncoordinated")
    assert course_of(run) is None
    assert driven_figure(run) is None
    assert "What the car" not in write_report(run.path).read_text()


@pytest.fixture
def with_twin(both: tuple[Run, Reference]) -> Run:
    """A run whose folder has that of its twin."""
    run, _ = both
    (run.path / "twin").mkdir()
    (run.path / "twin" / "run.json").write_text(json.dumps({"name": "unattacked"}))
    write_table(run.path / "twin" / "driven.parquet", course(hard=False))
    return run


def test_the_page_has_the_course_of_the_car_and_of_its_twin(with_twin: Run) -> None:
    data = run_block(with_twin)
    header, columns = unpack(data)
    own, twin = course(hard=True), course(hard=False)
    assert header["drives"] == [{"car": "ego", "twin": "unattacked"}]
    np.testing.assert_allclose(columns["drive.speed"], own["speed_mps"], atol=0.026)
    np.testing.assert_allclose(columns["drive.twin_x"], twin["x"], atol=0.006)
    np.testing.assert_array_equal(columns["drive.brake"], 2 * own["brake"])
    (event,) = [each for each in header["events"] if each["kind"] == "brake"]
    assert (event["frame"], event["x"]) == (17, pytest.approx(own["x"][17], abs=0.01))
    assert event["text"].endswith("shown by adversary_1)")


@pytest.mark.parametrize(
    "damaged",
    [
        *(7, [None], {"ego": 7}, {"ego": {"brakes": {}}}),
        {"ego": {"brakes": [7, {}, {"cause": {}}, {"from_s": "now"}]}},
        {"ego": {"collisions": [None, {"frame": "x"}, {"frame": 1 << 70, "object": 1}]}},
    ],
)
def test_a_page_of_damaged_consequences_shows_the_rest(damaged: Any, with_twin: Run) -> None:
    with_twin.files.summary["driven"] = damaged
    data = run_block(with_twin)
    header, columns = unpack(data)
    assert not [each for each in header["events"] if each["kind"] in ("brake", "collision")]
    assert not columns["drive.brake"].any()
    assert columns["drive.speed"].max() == pytest.approx(8.0)


@pytest.mark.parametrize("damage", ["no twin", "another run", "no table", "no parquet", "a list", "a link"])
def test_a_twin_that_cannot_be_read_is_left_out(damage: str, with_twin: Run, tmp_path: Path) -> None:
    folder = with_twin.path / "twin"
    assert twin_course(with_twin, "ego") is not None
    assert twin_course(with_twin, "mobile_1") is None
    if damage == "no twin":
        shutil.rmtree(folder)
    elif damage == "another run":
        (folder / "run.json").write_text('{"name": "mine"}')
    elif damage == "no table":
        (folder / "driven.parquet").unlink()
    elif damage == "no parquet":
        (folder / "driven.parquet").write_bytes(b"PAR1" * 20)
    elif damage == "a list":
        (folder / "run.json").write_text("[]")
    else:
        (folder / "driven.parquet").rename(tmp_path / "elsewhere.parquet")
        (folder / "driven.parquet").symlink_to(tmp_path / "elsewhere.parquet")
    assert twin_course(with_twin, "ego") is None


def test_a_film_shows_speed_rear_lights_and_the_twin(with_twin: Run) -> None:
    take = Take(with_twin, "picture")
    marks = DriveMarks(Figure().add_subplot(), take, THEMES["light"], 1.0)
    window = Window(0.0, 0.0, 50.0, 50.0)
    marks.show(10, window)
    assert marks.text.get_text() == "ego 8.0 m/s\nunattacked 8.0 m/s (broken line)"
    assert len(marks.lights.get_segments()) == 0
    marks.show(18, window)
    assert marks.text.get_text() == "ego 6.2 m/s, brakes needlessly 9.0 m/s²\nunattacked 8.0 m/s (broken line)"
    assert len(marks.lights.get_segments()) == 1
    assert "17: ego brakes" in Captions([take], {}).at(17)


def test_films_and_the_page_say_nothing_of_a_brake_while_it_is_interrupted(with_twin: Run) -> None:
    with_twin.files.driven["acceleration_mps2"][18:20] = 0.5, -1.2
    marks = DriveMarks(Figure().add_subplot(), Take(with_twin, "picture"), THEMES["light"], 1.0)
    for frame, lights in [(17, 1), (18, 0), (19, 0), (20, 1)]:
        marks.show(frame, Window(0.0, 0.0, 50.0, 50.0))
        assert len(marks.lights.get_segments()) == lights
        assert ("brakes" in marks.text.get_text()) == bool(lights)
    data = run_block(with_twin)
    assert unpack(data)[1]["drive.brake"][17:21].tolist() == [2, 0, 0, 2]
