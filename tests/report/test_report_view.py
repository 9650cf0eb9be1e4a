"""Which frame the pictures show, and which part of the world."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.view import choose_common_frame, choose_frame, clipped, frame_view, window


def a_run(picture: list[tuple[int, int]], local: list[tuple[int, int]] | None = None, attack: Any = None) -> RunFolder:
    """A run of which only the (FN, FP) of each frame and the attacked frames are known; frames count from 10."""
    rows = [("picture", k, *counts) for k, counts in enumerate(picture)]
    rows += [("local", k, *counts) for k, counts in enumerate(local or picture)]
    estimator, frame, fn, fp = (np.array(column) for column in zip(*rows, strict=True))
    counts = {"agent": np.full(len(fn), "ego"), "estimator": estimator, "frame": frame + 10, "fn": fn, "fp": fp}
    attacks = None if attack is None else {"frame": np.array(attack)}
    return RunFolder(Path("run"), {}, {}, {}, {}, counts, None, attacks, None, ())


def test_the_worst_frame_since_the_attack_began_is_shown() -> None:
    assert choose_frame(a_run([(9, 9), (0, 0), (1, 2), (2, 2), (0, 4)], attack=[11, 14])) == 13


def test_against_a_baseline_it_is_the_frame_that_is_worse_by_most() -> None:
    baseline = a_run([(0, 0), (0, 0), (0, 0), (4, 0), (0, 1)])
    assert choose_frame(a_run([(0, 0), (0, 0), (1, 2), (4, 1), (0, 5)], attack=[11]), baseline) == 14


def test_without_an_attack_it_is_the_frame_in_which_the_picture_helps_most() -> None:
    assert choose_frame(a_run([(1, 0), (1, 0), (3, 0)], local=[(4, 0), (6, 0), (7, 0)])) == 11


def test_an_attack_after_the_last_scored_frame_leaves_the_last() -> None:
    assert choose_frame(a_run([(1, 0), (0, 0)], attack=[50])) == 11


def test_a_run_without_counts_has_no_frame_to_show() -> None:
    run = a_run([(1, 0)])
    assert run.counts is not None
    empty = {name: column[:0] for name, column in run.counts.items()}
    assert choose_frame(RunFolder(Path("run"), {}, {}, {}, {}, empty, None, None, None, ())) is None


def test_runs_share_the_frame_of_the_largest_effect() -> None:
    baseline = a_run([(0, 0)] * 4)
    weak = a_run([(0, 0), (0, 2), (0, 0), (0, 0)], attack=[10])
    strong = a_run([(0, 0), (0, 0), (0, 5), (0, 0)], attack=[10])
    assert choose_common_frame([baseline, weak, strong], baseline) == 12
    assert choose_common_frame([baseline, a_run([(0, 0)] * 4)], baseline) == choose_frame(baseline)


def test_the_window_is_square_and_holds_all_that_is_near(run_folder: Callable[..., Path]) -> None:
    view = frame_view(RunFolder.load(run_folder()), 20)
    assert view is not None
    x, y, half = window([view])
    boxes = np.concatenate([boxes.position for of in view.boxes.values() for boxes in of.values()])
    ego = np.array([-70 + 0.8 * 20, -3.0])
    near = boxes[np.hypot(*(boxes[:, :2] - ego).T) < 105]
    assert np.abs(near[:, :2] - [x, y]).max() <= half


def test_what_an_adversary_does_far_away_is_not_in_the_view(run_folder: Callable[..., Path]) -> None:
    view = frame_view(RunFolder.load(run_folder("uncoordinated")), 20)
    assert view is not None
    assert len(view.added) == 10
    x, y, _ = view.added[0]
    assert len(clipped(view, (float(x), float(y), 0.5)).added) == 1
