"""What films draw is what was recorded."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from film_samples import ATTACK, FRAMES, images, rows_of, sheet_of
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from PIL import Image
from table_writing import write_table

import mast_zenoh as mast
from mast_zenoh.show.film.takes import Look
from mast_zenoh.show.film.writing import snapshot


def centres(outlines: object) -> np.ndarray:
    """(n, 2) m, sorted: the middles of drawn boxes."""
    paths = outlines.get_paths()  # type: ignore[attr-defined]
    drawn = np.array([path.vertices[:4].mean(axis=0) for path in paths]).reshape(-1, 2)
    return drawn[np.lexsort(drawn.T)]


@pytest.mark.parametrize(("agent", "estimate"), [("ego", "picture"), ("infra_1", "local")])
def test_every_box_is_drawn_where_it_was_scored_in_the_colour_of_its_outcome(
    attacked: mast.Run, agent: str, estimate: str
) -> None:
    sheet = sheet_of(attacked.path, Look(agent=agent, estimates=(estimate,)))
    rows = rows_of(attacked.path, "objects", agent=agent, estimator=estimate)
    assert len({row["frame"] for row in rows}) == FRAMES
    for frame in range(0, FRAMES, 3):
        sheet.show(frame)
        for name, artists in sheet.birdseye[0].outcomes.items():
            kind, _, outcome = name.rpartition(" ")
            here = [row for row in rows if row["frame"] == frame and row["outcome"] == outcome]
            expected = np.array([(row["x"], row["y"]) for row in here if kind in ("", row["kind"])]).reshape(-1, 2)
            np.testing.assert_allclose(centres(artists.outlines), expected[np.lexsort(expected.T)], atol=1e-9)
        counts = {row["outcome"] for row in rows if row["frame"] == frame}
        assert counts, "frames without boxes would prove nothing"


def test_the_truth_has_all_objects_of_the_scene(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path, Look(estimates=("truth",)))
    sheet.show(12)
    expected = np.array([(row["x"], row["y"]) for row in attacked.truth.to_pylist() if row["frame"] == 12])
    drawn = centres(sheet.birdseye[0].outcomes["truth matched"].outlines)
    np.testing.assert_allclose(drawn, expected[np.lexsort(expected.T)], atol=1e-9)


def test_manipulations_are_drawn_where_they_were_measured(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path)
    for effect, when in (("inserted", "after"), ("removed", "before")):
        rows = rows_of(attacked.path, "attacks", effect=effect)
        assert rows
        for frame in range(FRAMES):
            sheet.show(frame)
            x, y = getattr(sheet.birdseye[0], effect).get_data()
            expected = [(row[f"{when}_x"], row[f"{when}_y"]) for row in rows if row["frame"] == frame]
            np.testing.assert_allclose(sorted(zip(x, y, strict=True)), sorted(expected))


def test_agents_are_where_they_said(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path)
    sheet.show(20)
    for mark, name in zip(sheet.birdseye[0].agents.marks, attacked.agents, strict=True):
        pose = next(row for row in attacked.agent(name).pose.to_pylist() if row["frame"] == 20)
        assert [float(axis[0]) for axis in mark.get_data()] == pytest.approx([pose["x"], pose["y"]], abs=1e-6)


def test_the_numbers_and_the_clock_are_those_of_the_frame(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path)
    for frame in (3, 25):
        sheet.show(frame)
        (row,) = rows_of(attacked.path, "metrics", agent="ego", estimator="picture", frame=frame)
        words = [text.get_text() for text in sheet.figure.texts]
        assert {f"{row['fn']} missed", f"{row['fp']} false", f"{row['tp']} matched"} <= set(words)
        assert f"RMSE {row['rmse_m']:.2f} m" in words
        assert f"t = {frame / 10:.1f} s   frame {frame}" in words


def test_a_false_track_is_red_in_the_file_at_its_place(attacked: mast.Run, tmp_path: Path) -> None:
    frame = 25
    look = Look(theme="dark", window="0,0,60")
    sheet = sheet_of(attacked.path, look, frames=range(frame, frame + 1))
    sheet.show(frame)
    sheet.figure.canvas.draw()
    snapshot(attacked.path, tmp_path / "still.png", look, frame)
    image = np.asarray(Image.open(tmp_path / "still.png").convert("RGB"), int)
    rows = rows_of(attacked.path, "objects", agent="ego", estimator="picture", outcome="false", frame=frame)
    assert rows
    for row in rows:
        x, y = sheet.birdseye[0].axes.transData.transform((row["x"], row["y"]))
        around = image[len(image) - int(y) - 4 : len(image) - int(y) + 4, int(x) - 4 : int(x) + 4]
        red = (around[..., 0] > 200) & (around[..., 1] < 110) & (around[..., 2] < 110)
        assert red.any(), f"nothing red at {x:.0f}, {y:.0f}"


@pytest.mark.parametrize("look", [Look(), Look(window="follow", estimates=("local", "picture")), Look(camera=True)])
def test_drawing_only_what_changes_gives_the_same_pixels_as_drawing_everything(attacked: mast.Run, look: Look) -> None:
    *_, quick = images(sheet_of(attacked.path, look), (2, 15, 27))
    whole = sheet_of(attacked.path, look)
    whole.show(27)
    canvas = FigureCanvasAgg(whole.figure)
    canvas.draw()
    np.testing.assert_array_equal(quick, np.asarray(canvas.buffer_rgba())[..., :3])


def test_an_attack_is_visible_as_long_as_it_is_on(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path)
    for frame, on in ((ATTACK - 1, False), (ATTACK + 1, True)):
        sheet.show(frame)
        words = " ".join(text.get_text() for text in sheet.figure.texts)
        assert ("adversary_1, adversary_2" in words) == on
        assert sheet.birdseye[0].alarm.get_visible() == on
        assert ("UncoordinatedAttack adversary_1, adversary_2" in words) == on


def test_many_adversaries_are_counted(edited: Path) -> None:
    rows = rows_of(edited, "attacks")
    (frame, *_) = (row["frame"] for row in rows)
    names = ("adversary_1", "adversary_2", "adversary_3")
    more = [{**rows[0], "interposer": name} for name in names]
    columns = {name: [row[name] for row in (*more, *rows)] for name in rows[0]}
    known = {name: [math.nan if value is None else value for value in values] for name, values in columns.items()}
    write_table(edited / "attacks.parquet", known)
    sheet = sheet_of(edited)
    sheet.show(frame)
    assert "3 adversaries" in " ".join(text.get_text() for text in sheet.figure.texts)


def test_live_interceptions_have_captions_and_mark_the_agent_while_they_last(intercepted: Path) -> None:
    sheet = sheet_of(intercepted)
    captions, marked = {}, {}
    names = sheet.birdseye[0].agents.names
    for frame in (7, 8, 10, 19, 20):
        sheet.show(frame)
        captions[frame] = next((each.get_text() for each in sheet.figure.texts if "frame" in each.get_text()[:5]), "")
        marked[frame] = [name.get_text() for name in names if to_hex(name.get_color()) == "#ff4fd8"]
    assert captions[7] == ""
    assert captions[8].startswith("frame 8: adversary_1")
    assert captions[8].endswith("…"), "it is too long for the figure"
    assert captions[10] == captions[19] == "frame 10: adversary_2 inserted on agent/infra_2/detections"
    assert captions[20] == "frame 20: adversary_1 released from agent/infra_1/detections"
    assert marked == {7: [], 8: ["infra_1"], 10: ["infra_1", "infra_2"], 19: ["infra_1", "infra_2"], 20: ["infra_2"]}


def test_a_caption_of_ones_own_replaces_that_of_the_run_until_the_next_event(intercepted: Path) -> None:
    sheet = sheet_of(intercepted, Look(captions=("10:costs $5: now two",)))
    sheet.show(11)
    assert r"costs \$5: now" in " ".join(text.get_text() for text in sheet.figure.texts)
    sheet.show(20)
    words = " ".join(text.get_text() for text in sheet.figure.texts)
    assert "20: adversary_1 released" in words, "the next event is shown"


def test_a_distant_false_track_does_not_widen_the_window(edited: Path) -> None:
    def limits() -> np.ndarray:
        sheet = sheet_of(edited)
        sheet.show(15)
        return np.array([sheet.birdseye[0].axes.get_xlim(), sheet.birdseye[0].axes.get_ylim()])

    before = limits()
    assert np.diff(before)[0] > 40
    rows = rows_of(edited, "objects")
    false = next(row for row in rows if row["agent"] == "ego" and row["outcome"] == "false")
    moved = [{**false, "x": false["x"] + distance} for distance in (90.0, 900.0)]  # type: ignore[operator]
    write_table(edited / "objects.parquet", {name: [row[name] for row in (*rows, *moved)] for name in rows[0]})
    np.testing.assert_allclose(limits(), before, atol=3)


def test_errors_outside_the_window_are_marked_at_its_edge(attacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path, Look(window="0,0,15"))
    panel, marked = sheet.birdseye[0], 0
    sheet.show(0)
    (left, right), (bottom, top) = panel.axes.get_xlim(), panel.axes.get_ylim()
    for frame in range(FRAMES):
        sheet.show(frame)
        for name, points in panel.outside.items():
            at = centres(panel.outcomes[name].outlines)
            inside = (at > [left, bottom]).all(axis=1) & (at < [right, top]).all(axis=1)
            x, y = (np.asarray(axis) for axis in points.get_data())
            assert len(x) == (~inside).sum()
            assert np.all(np.isin(x, [left, right]) | np.isin(y, [bottom, top]))
            marked += len(x)
    assert marked > 0


def test_a_window_that_follows_keeps_the_agent_in_the_middle(attacked: mast.Run) -> None:
    axes = (sheet := sheet_of(attacked.path, Look(window="follow:30"))).birdseye[0].axes
    poses = {row["frame"]: (row["x"], row["y"]) for row in attacked.agent("ego").pose.to_pylist()}
    assert poses[0] != pytest.approx(poses[FRAMES - 1], abs=5)
    for frame in (0, FRAMES - 1):
        sheet.show(frame)
        limits = np.array([axes.get_xlim(), axes.get_ylim()])
        np.testing.assert_allclose(limits.mean(axis=1), poses[frame], atol=1e-6)
        assert min(np.diff(limits, axis=1)) == pytest.approx(60)


def test_two_runs_are_shown_at_the_same_time_until_one_ends(attacked: mast.Run, unattacked: mast.Run) -> None:
    sheet = sheet_of(attacked.path, against=unattacked.path)
    ours, theirs = sheet.birdseye
    sheet.show(15)
    for panel, run in ((ours, attacked), (theirs, unattacked)):
        (row,) = rows_of(run.path, "metrics", agent="ego", estimator="picture", frame=15)
        assert f"{row['fp']} false" in [text.get_text() for text in sheet.figure.texts]
        assert not panel.over.get_visible()
    assert ours.alarm.get_visible()
    assert not theirs.alarm.get_visible()
    sheet.show(25)
    assert theirs.over.get_visible()
    assert not ours.over.get_visible()


def test_agents_that_are_down_say_so(edited: Path) -> None:
    record = json.loads((edited / "run.json").read_text())
    record["steps"] = [{"node": "infra_3", "action": "stop", "frame": 10}]
    (edited / "run.json").write_text(json.dumps(record))
    sheet = sheet_of(edited)
    sheet.show(9)
    names = sheet.birdseye[0].agents.names
    assert "infra_3" in [name.get_text() for name in names]
    sheet.show(10)
    assert "infra_3\ndown" in [name.get_text() for name in names]


@pytest.mark.parametrize("size", ["700x420", "1280x760"])
def test_numbers_of_narrow_panels_do_not_overlap(attacked: mast.Run, size: str) -> None:
    sheet = sheet_of(attacked.path, Look(estimates=("local", "picture"), size=size))
    sheet.show(25)
    words = ("missed", "false", "matched", "RMSE")
    shown = [text for text in sheet.figure.texts if any(word in text.get_text() for word in words)]
    boxes = sorted((text.get_window_extent() for text in shown), key=lambda box: box.x0)
    assert len(boxes) == 8
    assert all(box.x1 < following.x0 for box, following in pairwise(boxes))
    assert boxes[-1].x1 <= sheet.figure.bbox.x1
