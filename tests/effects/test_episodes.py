"""Inserted objects without ids are tracked through noise and gaps."""

import numpy as np

from mast_zenoh.evaluation.effects import EFFECTS, Effects
from mast_zenoh.evaluation.effects.table import MAX_GAP_S, insertions

PERIOD_S = 0.1


def inserted(frame: list[int], place: list[tuple[float, float]], id_: list[int] | None = None) -> Effects:
    """Insertions on one passage, by frame."""
    n = len(frame)
    order = np.argsort(frame, kind="stable")
    zeros, nowhere = np.zeros(n, np.int64), np.full((n, 3), np.nan)
    return Effects(
        passages=(),
        passage=zeros,
        code=np.full(n, EFFECTS.index("inserted")),
        frame=np.asarray(frame, np.int64)[order],
        seq=zeros,
        step=np.asarray(frame, np.int64)[order],
        id=np.full(n, -1) if id_ is None else np.asarray(id_, np.int64)[order],
        before=nowhere,
        after=np.column_stack([np.asarray(place, float).reshape(n, 2), np.zeros(n)])[order],
        velocity=nowhere,
        whole=np.zeros(n, bool),
        frames_late=zeros,
        time_ns=zeros,
        columns=np.full(n, "", object),
        points=zeros,
    )


def drive(
    rng: np.random.Generator, start: tuple[float, float], velocity: tuple[float, float], frames: int, share: float
) -> tuple[list[int], list[tuple[float, float]]]:
    """Frames and noisy positions of an object shown in a share of the frames."""
    visible_frames = [k for k in range(frames) if k % 8 == 0 or rng.random() < share]
    noise = rng.normal(0.0, 0.4, (len(visible_frames), 2))
    places = [(start[0] + velocity[0] * k * PERIOD_S, start[1] + velocity[1] * k * PERIOD_S) for k in visible_frames]
    return visible_frames, [(x + dx, y + dy) for (x, y), (dx, dy) in zip(places, noise.tolist(), strict=True)]


def test_noise_and_misses_split_at_most_one_object_in_a_hundred() -> None:
    split = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        speed, share = rng.uniform(0.0, 15.0), rng.uniform(0.4, 1.0)
        frames, places = drive(rng, (0.0, 0.0), (speed, 0.0), 100, share)
        others, far = drive(rng, (0.0, 40.0), (-speed, 0.0), 100, share)
        effects = inserted(frames + others, places + far)
        rows, episode, velocity = insertions(effects, PERIOD_S)
        assert len(rows) == len(frames) + len(others)
        is_far = effects.after[rows][:, 1] > 20.0
        kinds = set(zip(episode.tolist(), is_far.tolist(), strict=True))
        assert len(kinds) == len(np.unique(episode)), "no two objects are merged"
        split += len(kinds) > 2
        for side in (is_far, ~is_far):
            assert abs(abs(np.median(velocity[side][:, 0])) - speed) < 2.0
    assert split <= 2


def test_an_object_after_a_long_gap_is_a_new_one() -> None:
    gap = round(MAX_GAP_S / PERIOD_S)
    for pause, objects in ((gap, 1), (gap + 1, 2)):
        frames = [*range(10), *range(9 + pause, 20 + pause)]
        _, episode, _ = insertions(inserted(frames, [(0.0, 0.0)] * len(frames)), PERIOD_S)
        assert len(np.unique(episode)) == objects


def test_ids_take_precedence_in_matching() -> None:
    frames = [k for k in range(20) for _ in range(2)]
    places = [(0.0, 0.0), (0.2, 0.0)] * 20
    _, episode, _ = insertions(inserted(frames, places, [7, 8] * 20), PERIOD_S)
    assert np.bincount(episode).tolist() == [20, 20]
