"""The frame and the window that pictures show."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.drawing import birdseye_figure, camera_figure
from mast_zenoh.show.figures.view import choose_common_frame, choose_frame, frame_view, window_of


def a_run(
    picture: list[tuple[int, int]],
    local: list[tuple[int, int]] | None = None,
    attack: Any = None,
    scored: tuple[int, int] | None = None,
) -> Run:
    """A run with known (FN, FP) and attacked frames only; frames start at 10."""
    rows = [("picture", k, *counts) for k, counts in enumerate(picture)]
    rows += [("local", k, *counts) for k, counts in enumerate(local or picture)]
    estimator, frame, fn, fp = (np.array(column) for column in zip(*rows, strict=True))
    nothing = np.zeros(len(fn))
    counts = {"agent": np.full(len(fn), "ego"), "estimator": estimator, "frame": frame + 10, "fn": fn, "fp": fp}
    counts |= {"tp": nothing, "rmse_m": nothing, "id_switches": nothing}
    effects = None
    if attack is not None:
        kinds = {"effect": np.full(len(attack), "inserted"), "role": np.full(len(attack), "adversary")}
        effects = {"frame": np.array(attack)} | kinds
    metrics = {} if scored is None else {"scored_frames": list(scored)}
    return Run.of(RunFiles(None, summary=metrics, counts=counts, effects=effects))


WORST_AT_BOTH_ENDS = [(9, 9), (1, 0), (2, 0), (9, 9)]


@pytest.mark.parametrize(
    ("run", "frame"),
    [
        (a_run([(9, 9), (0, 0), (1, 2), (2, 2), (0, 4)], attack=[11, 14]), 13),  # the worst since the attack began
        (a_run([(1, 0), (1, 0), (3, 0)], local=[(4, 0), (6, 0), (7, 0)]), 11),  # without an attack, the best
        (a_run([(1, 0), (0, 0), (0, 0)], local=[(1, 0), (2, 0), (9, 0)], attack=[50]), 12),
        (a_run(WORST_AT_BOTH_ENDS, attack=[10], scored=(11, 12)), 12),
        (a_run(WORST_AT_BOTH_ENDS, scored=(11, 12)), 11),
        (a_run([(9, 9)] * 2, scored=(20, 30)), None),
    ],
)
def test_the_scored_frame_with_the_largest_effect_of_the_attack_or_benefit_is_shown(
    run: Run, frame: int | None
) -> None:
    assert choose_frame(run) == frame


def test_the_frame_of_compared_runs_has_the_largest_difference_and_one_with_unsettled_effects_is_never_chosen() -> None:
    baseline = a_run([(0, 0), (0, 0), (0, 0), (4, 0), (0, 1)])
    assert choose_frame(a_run([(0, 0), (0, 0), (1, 2), (4, 1), (0, 5)], attack=[11]), baseline) == 14
    run = a_run([(0, 0), (1, 0), (9, 0), (2, 0)], attack=[11, 12, 13])
    run.files.effects["effect"] = np.array(["inserted", "unsettled", "inserted"])
    assert choose_frame(run) == 13
    baseline = a_run([(0, 0)] * 4)
    weak, strong = (
        a_run([(0, 0), (0, 2), (0, 0), (0, 0)], attack=[10]),
        a_run([(0, 0), (0, 0), (0, 5), (0, 0)], attack=[10]),
    )
    assert choose_common_frame([baseline, weak, strong], baseline) == 12
    assert choose_common_frame([baseline, a_run([(0, 0)] * 4)], baseline) == choose_frame(baseline)


def test_errors_of_all_kinds_count() -> None:
    run = a_run([(0, 0)] * 4, attack=[10])
    picture = np.flatnonzero(run.files.counts["estimator"] == "picture")
    run.files.counts["tp"] = np.full(8, 20)
    run.files.counts["rmse_m"] = np.zeros(8)
    run.files.counts["rmse_m"][picture[1]] = 1.0
    assert choose_frame(run) == 11
    run.files.counts["id_switches"] = np.zeros(8)
    run.files.counts["id_switches"][picture[3]] = 1
    assert choose_frame(run) == 13


def test_window_is_square_and_contains_all_nearby_objects(run_folder: Callable[..., Path]) -> None:
    view = frame_view(Run(run_folder()), 20)
    window = window_of([view])
    assert window.across == window.up
    boxes = np.concatenate([boxes.position for of in view.boxes.values() for boxes in of.values()])
    ego = np.array([-70 + 0.8 * 20, -3.0])
    near = boxes[np.hypot(*(boxes[:, :2] - ego).T) < 105]
    assert all(window.contains(position) for position in near)


def test_the_estimate_used_to_choose_a_frame_is_shown(run_folder: Callable[..., Path]) -> None:
    run = Run(run_folder("uncoordinated"))
    touched = run.files.objects["estimator"] == "picture"
    more = {name: np.concatenate([column, column[touched]]) for name, column in run.files.objects.items()}
    more["estimator"] = more["estimator"].astype(object)
    more["estimator"][len(touched) :] = "picture_on_arrival"
    run.files.objects = more
    run.files.summary["same_as"]["ego"]["picture_received"] = "picture_on_arrival"
    view = frame_view(run, 20, "picture_received")
    assert list(view.boxes) == ["local", "picture_received", "mission"]
    assert len(view.boxes["picture_received"]["track false"]) == 10
    run.files.effects["message"] = np.full(len(run.files.effects["frame"]), "picture")
    assert len(replace(view, run=run.with_()).behind.added) == 10
    assert len(replace(view, run=run.with_()).marks("picture_received").added) == 10
    titles = [axes.get_title(loc="left") for axes in birdseye_figure(view).axes]
    assert "ego receives" in titles[1]
    assert camera_figure(view) is not None
    del run.files.summary["same_as"]["ego"]["picture_received"]
    without_boxes = frame_view(run, 20, "picture_received")
    assert without_boxes is not None
    assert list(without_boxes.boxes) == ["local", "picture", "mission"]
