"""All boxes of a run, each once, and what each estimate of each agent makes of them.

objects.parquet has a row per box, agent and estimate: a truth object appears up to thirty times in a frame, and the
picture once for every agent. Here a box is stored once, next to the same object's box in the next frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.launch.tables import read_arrow
from mast_zenoh.report.files import Table
from mast_zenoh.scenes.recording import Recording

#: m, rad and 1: resolution of positions and sizes, of headings, and of scores.
LENGTH, ANGLE, SCORE = 0.01, 0.002, 0.01
_COLUMNS = ("frame", "agent", "estimator", "kind", "outcome", "id", "match_id", "x", "y", "z", "l", "w", "h", "yaw")


class View(NamedTuple):
    """An estimate of an agent that has its own boxes."""

    agent: str
    estimate: str


class Meaning(NamedTuple):
    """What a box is in a view: outcome, cause and adversary (empty: none)."""

    outcome: str
    cause: str
    by: str


@dataclass(frozen=True, eq=False)
class BoxTable:
    """m boxes, those of one object in consecutive rows, and their meaning in v views.

    truth:    (m,) whether a box is the truth, not a track
    frame, id: (m,)
    geometry: (m, 7) x y z l w h in m, yaw in rad;  score: (m,) 0 to 1, 0 for truth
    codes:    (v, m) 0: not in this view; otherwise 1 + the row of `meanings`
    matches:  (v, m) id of the object that a matched track follows; -1: none
    """

    truth: Bools
    frame: Ints
    id: Ints
    geometry: Floats
    score: Floats
    views: tuple[View, ...]
    meanings: tuple[Meaning, ...]
    codes: NDArray[np.uint16]
    matches: Ints


def read_boxes(path: Path, recording: Recording | None) -> BoxTable:
    """The boxes of objects.parquet, and all objects of the recorded scene.

    Raises OSError, ValueError or ArrowException if the file cannot be read.
    """
    return boxes_of(read_arrow(path), recording)


def boxes_of(content: Any, recording: Recording | None) -> BoxTable:
    """The boxes of an Arrow table with the columns of objects.parquet, and all objects of the recorded scene.

    Raises ValueError if a column is absent.
    """
    table, names = _table(content)
    views = tuple(View(*pair) for pair in names["view"])
    truth = table["kind"] == 1
    # The truth of a frame is the same in every view: its id alone identifies it.
    geometry = np.stack([table[name] for name in ("x", "y", "z", "l", "w", "h", "yaw")], axis=1)
    score = np.nan_to_num(table["score"])
    of_tracks = np.where(truth[:, None], 0.0, np.column_stack([geometry, score]))
    key = row_keys(table["frame"], table["id"], truth, of_tracks)
    unique, first, row = np.unique(key, return_index=True, return_inverse=True)
    stream = np.full(len(unique), len(views))
    np.minimum.at(stream, row, table["view"])
    columns = [truth[first], table["frame"][first], table["id"][first], geometry[first], score[first]]
    unseen = _unseen(recording, columns[0], columns[1], columns[2])
    columns = [np.concatenate(pair) for pair in zip(columns, unseen, strict=True)]
    stream = np.where(columns[0], -1, np.append(stream, np.zeros(len(unseen[0]), int)))
    order = np.lexsort((columns[1], columns[2], stream))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    codes = np.zeros((len(views), len(order)), np.uint16)
    codes[table["view"], place[row]] = table["meaning"] + 1
    matches = np.full((len(views), len(order)), -1, np.int64)
    followed = ~truth & (table["match_id"] >= 0)
    matches[table["view"][followed], place[row[followed]]] = table["match_id"][followed]
    meanings = tuple(Meaning(*each) for each in names["meaning"])
    return _box_table([column[order] for column in columns], views, meanings, codes, matches)


def no_boxes(recording: Recording | None) -> BoxTable:
    """The boxes of a run without objects.parquet: only the recorded scene."""
    none = np.zeros(0, np.int64)
    columns = _unseen(recording, none.astype(bool), none, none)
    order = np.lexsort((columns[1], columns[2]))
    codes = np.zeros((0, len(order)))
    return _box_table([each[order] for each in columns], (), (), codes.astype(np.uint16), codes.astype(np.int64))


def _box_table(
    columns: list[NDArray[Any]],
    views: tuple[View, ...],
    meanings: tuple[Meaning, ...],
    codes: NDArray[np.uint16],
    matches: Ints,
) -> BoxTable:
    truth, frame, ids, geometry, score = columns
    return BoxTable(truth, frame, ids, geometry, score, views, meanings, codes, matches)


def _table(content: Any) -> tuple[Table, dict[str, list[tuple[str, ...]]]]:
    """The columns as numbers, with `view` and `meaning` as rows of the returned names."""
    if absent := sorted(set(_COLUMNS) - set(content.column_names)):
        raise ValueError(f"found no column {', '.join(absent)}")
    rows = content.num_rows
    table = {name: content[name].to_numpy() for name in ("frame", "id", "match_id", *_COLUMNS[7:])}
    table["score"] = content["score"].to_numpy() if "score" in content.column_names else np.zeros(rows)
    text = {name: _words(content, name) for name in ("agent", "estimator", "kind", "outcome", "cause", "by")}
    kind_words, kinds = text["kind"]
    table["kind"] = np.array([word == "truth" for word in kind_words], np.int64)[kinds] if rows else kinds
    names = {}
    for name, parts in (("view", ("agent", "estimator")), ("meaning", ("outcome", "cause", "by"))):
        combined = np.zeros(rows, np.int64)
        for part in parts:
            combined = combined * (len(text[part][0]) + 1) + text[part][1]
        _, first, table[name] = np.unique(combined, return_index=True, return_inverse=True)
        names[name] = [tuple(text[part][0][text[part][1][row]] for part in parts) for row in first]
    return table, names


def _words(content: Any, name: str) -> tuple[list[str], Ints]:
    """The distinct texts of a column, and the row of each in them; one empty text if the column is absent."""
    if name not in content.column_names:
        return [""], np.zeros(content.num_rows, np.int64)
    column = content[name].combine_chunks()
    column = column.chunk(0) if hasattr(column, "chunk") else column
    if not hasattr(column, "dictionary"):  # of another writer
        words, place = np.unique(np.array(column.to_pylist(), str), return_inverse=True)
        return words.tolist(), place.astype(np.int64)
    return column.dictionary.to_pylist(), column.indices.to_numpy(zero_copy_only=False).astype(np.int64)


def row_keys(*columns: NDArray[np.generic]) -> NDArray[np.uint64]:
    """(n,) A 64-bit hash of the bits of each row."""
    result = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        numbers = np.asarray(column, np.float64)
        for part in numbers.T if numbers.ndim > 1 else [numbers]:
            bits = np.ascontiguousarray(part + 0.0).view(np.uint64)
            result = (result ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            result ^= result >> np.uint64(29)
    return result


def _unseen(recording: Recording | None, truth: Bools, frame: Ints, ids: Ints) -> list[NDArray[Any]]:
    """The recorded objects that no view has, as columns of BoxTable up to the score."""
    if recording is None:
        nothing = np.zeros(0, np.int64)
        return [nothing.astype(bool), nothing, nothing, np.zeros((0, 7)), np.zeros(0)]
    states, last = recording.truth, frame.max() if len(frame) else len(recording) - 1
    frames = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
    known = row_keys(frame[truth], ids[truth])
    new = ~np.isin(row_keys(frames, states.id), known) & (frames <= last)
    geometry = np.column_stack([states.position, states.size, states.yaw])[new]
    return [np.ones(new.sum(), bool), frames[new], states.id[new], geometry, np.zeros(new.sum())]
