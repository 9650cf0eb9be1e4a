"""A long run opens at once and in little memory; its page holds every n-th frame."""

import shutil
import subprocess
import sys
from pathlib import Path
from statistics import median

import numpy as np
import pytest
from equal_runs import run_alone
from long_run import SHORT_FRAMES, repeated, sparse
from page_blocks import unpack

import mast_zenoh as mast
from mast_zenoh.config import loading
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.run_folder.tables import TableFile, read_table
from mast_zenoh.runs import files as run_files
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes import recording as recording_module
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.film.takes import Take
from mast_zenoh.show.film.writing import schedule
from mast_zenoh.show.html import write_report
from mast_zenoh.show.page.block import run_block

pytestmark = pytest.mark.long

opening = loading.module(Path(__file__).parents[2] / "benchmarks" / "opening.py")
EVERY = 4

#: Writes the page of a run and prints its peak memory, KiB (`ru_maxrss` would be that of the parent, too).
WRITE_PAGE = """
import pathlib, re, sys
from mast_zenoh.show import html
html.write_report(pathlib.Path(sys.argv[1]))
print(re.search(r"VmHWM:\\s+(\\d+) kB", pathlib.Path("/proc/self/status").read_text())[1])
"""


@pytest.fixture
def long(recorded: mast.Run, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that is long for a page."""
    frames = read_json(recorded.path / "metrics.json")["frames"]
    monkeypatch.setattr(run_files, "MOST_FRAMES", -(-frames // EVERY))
    return recorded.path


def test_of_a_long_run_every_nth_frame_is_shown_and_peaks_stay(long: Path) -> None:
    run = Run(long)
    whole = run.with_(sample=run_files.ALL)
    assert run.files.sample.step == EVERY
    (header, columns), (_, every) = (unpack(run_block(each)) for each in (run, whole))
    frames = header["frames"]
    assert header["numbers"] == [0, EVERY]
    np.testing.assert_allclose(columns["time"], every["time"][::EVERY])
    inside = every["box.frame"] % EVERY == 0
    assert len(columns["box.frame"]) == inside.sum()
    np.testing.assert_array_equal(np.unique(columns["box.frame"]), np.unique(every["box.frame"][inside] // EVERY))
    for name in ("fn", "fp", "rmse_m"):
        shown, peaks = (columns[f"{kind}.{name}"].reshape(-1, frames) for kind in ("series", "peaks"))
        values = every[f"series.{name}"].reshape(len(shown), -1)
        np.testing.assert_allclose(shown, values[:, ::EVERY])
        ends = [min((place + 1) * EVERY, values.shape[1]) for place in range(frames)]
        expected = [values[:, place * EVERY : end].max(axis=1) for place, end in enumerate(ends)]
        np.testing.assert_allclose(peaks, np.transpose(expected))


def test_a_run_with_many_boxes_is_long_too(recorded: mast.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    n_boxes = recorded.files.all_objects.num_rows
    monkeypatch.setattr(run_files, "MOST_BOXES", n_boxes)
    assert Run(recorded.path).files.sample == run_files.ALL
    monkeypatch.setattr(run_files, "MOST_BOXES", n_boxes - 1)
    assert Run(recorded.path).files.sample == range(0, run_files.ALL.stop, 2)


def test_events_of_a_long_run_have_their_own_time(long: Path) -> None:
    run = Run(long)
    header = unpack(run_block(run))[0]
    first = next(event for event in header["events"] if event["kind"] == "effect")
    assert first["time"] == pytest.approx(run.attack_frames[0] * run.period_s)
    assert first["frame"] == run.attack_frames[0] // EVERY


def test_a_frame_that_is_asked_for_is_among_those_of_a_long_run(long: Path) -> None:
    header = unpack(run_block(Run(long, 7), 7))[0]
    first, every = header["numbers"]
    assert first + every * header["frame"] == 7
    with pytest.raises(ValueError, match=r"frame 6.*3"):
        run_block(Run(long, 7), 6)


def test_frames_of_a_long_run_are_judged_as_those_of_a_short_one(
    long: Path, recorded: mast.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mast_zenoh.runs.run._AROUND", 9)
    judged = list(frames_of(open_recorded(long)))
    monkeypatch.setattr(run_files, "MOST_FRAMES", 10**6)
    for frame, other in zip(judged, frames_of(open_recorded(recorded.path)), strict=True):
        assert str(frame.scores) == str(other.scores), "there may be NaN in them"
        assert frame.changes.sentences == other.changes.sentences
        for series, outcomes in other.outcomes.items():
            np.testing.assert_array_equal(frame.outcomes[series].code, outcomes.code)


@pytest.mark.usefixtures("without_figures")
def test_the_page_of_a_long_run_says_what_it_holds(long: Path) -> None:
    page = write_report(long).read_text("utf-8")
    assert f"{EVERY}, scores" in page


@pytest.mark.heavy
def test_the_page_of_a_run_four_times_as_long_as_it_shows_is_small_and_made_in_bounded_memory(tmp_path: Path) -> None:
    short = run_alone(tmp_path / "short", "defended", "scene.dense=False", frames=200)
    folder = repeated(short, tmp_path / "long", 4 * run_files.MOST_FRAMES // 200)
    peak = subprocess.run([sys.executable, "-c", WRITE_PAGE, str(folder)], check=True, capture_output=True, text=True)
    assert (folder / "report.html").stat().st_size < 20e6
    assert int(peak.stdout) < 3 << 20


def test_a_film_of_a_long_run_shows_every_frame_whole(
    long: Path, recorded: mast.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mast_zenoh.runs.run._AROUND", 9)
    take = Take(Run(long), "picture")
    monkeypatch.setattr(run_files, "MOST_FRAMES", 10**6)
    whole = Take(Run(recorded.path), "picture")
    assert (take.first, take.last) == (whole.first, whole.last)
    for frame in range(take.first, take.last + 1):
        for outcome, boxes in whole.view(frame).boxes["picture"].items():
            np.testing.assert_array_equal(take.view(frame).boxes["picture"][outcome].position, boxes.position)
        marks, others = take.view(frame).marks("picture"), whole.view(frame).marks("picture")
        for name in ("added", "removed", "moved"):
            assert np.array_equal(getattr(marks, name), getattr(others, name))


def test_a_film_of_a_long_run_ends_by_itself(recorded: mast.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mast_zenoh.show.film.writing.MOST_FRAMES", 12)
    take = Take(Run(recorded.path), "picture")
    assert list(schedule(take, 5, None, 1.0, None).frames) == [*range(5, 17)]
    assert list(schedule(take, 5, 25, 1.0, None).frames) == [*range(5, 26)]


def test_frames_of_a_sparse_run_are_those_of_its_whole_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = 3 * SHORT_FRAMES
    folder = sparse(tmp_path / "run", frames, 4)
    run = mast.open(folder)
    assert run.status == "ok"
    assert run.agents == ("ego", "infra_1", "infra_2", "infra_3")
    assert "infra_1" in run.report().read_text("utf-8")
    assert [message.frame for message in read(folder)] == list(range(frames))
    for name in ("metrics", "objects", "attacks"):
        file, whole = TableFile(folder / f"{name}.parquet"), read_table(folder / f"{name}.parquet")
        first, last = int(whole["frame"].min()), int(whole["frame"].max())
        assert last == frames - 1
        for frame in (first, SHORT_FRAMES, last):
            rows = file.rows(list(whole), range(frame, frame + 1))
            assert len(rows["frame"]) > 0 or frame == SHORT_FRAMES
            for column, values in rows.items():
                np.testing.assert_array_equal(values, whole[column][whole["frame"] == frame])
    monkeypatch.setattr(recording_module, "MAPPED_BYTES", 0)
    opened, loaded = Recording.open(folder / "scene.npz"), Recording.load(folder / "scene.npz")
    assert len(loaded) == frames
    for frame in range(frames):
        np.testing.assert_array_equal(opened.truth_at(frame).position, loaded.truth_at(frame).position)
        np.testing.assert_array_equal(
            opened.detections_at(frame, 2).covariance, loaded.detections_at(frame, 2).covariance
        )


def test_a_report_with_a_scene_that_stays_in_its_file_equals_that_with_one_in_memory(
    recorded: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = mast.open(shutil.copytree(recorded.path, tmp_path / "run"))
    in_memory = run.report().read_text("utf-8")
    monkeypatch.setattr(recording_module, "MAPPED_BYTES", 0)
    assert run.report().read_text("utf-8") == in_memory


@pytest.mark.heavy
@pytest.mark.timeout(600)  # a minute of writing
def test_a_run_100_times_as_long_opens_in_less_than_10_times_the_processor_time_and_in_300_mb(tmp_path: Path) -> None:
    """100 agents; benchmarks/opening.py gives seconds."""
    folders = [sparse(tmp_path / str(frames), frames, 100) for frames in (100, 10_000)]
    used: list[list[float]] = [[], []]
    for _ in range(3):
        for folder, frame, seconds in zip(folders, (50, 5000), used, strict=True):
            steps = opening.measure(folder, frame)
            del steps["imports"]
            seconds.append(sum(processor for _, processor, _ in steps.values()))
            assert max(peak for _, _, peak in steps.values()) < 300
    short, long = map(median, used)
    assert long < 10 * short
