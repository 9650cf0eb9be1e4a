"""The data block of the moving picture holds what the run recorded."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from page_blocks import unpack

from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.page.block import run_block, shown_id
from mast_zenoh.show.page.motion import Packer

Block = tuple[dict, dict[str, NDArray[np.float64]]]


@pytest.fixture(scope="module")
def block(loaded_run: Run) -> Block:
    data = run_block(loaded_run)
    return unpack(data)


def rows_of_view(block: Block, agent: str, estimate: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The boxes of a view and their codes."""
    header, columns = block
    row = next(v["row"] for v in header["views"] if (v["agent"], v["estimate"]) == (agent, estimate))
    codes = columns["code"].reshape(-1, len(columns["box.frame"]))[row].astype(np.int64)
    shown = np.flatnonzero(codes)
    return shown, codes[shown]


def test_every_box_of_every_estimate_is_in_the_block_with_its_outcome(block: Block, attacked_run: Path) -> None:
    header, columns = block
    table = read_table(attacked_run / "objects.parquet")
    views = sorted(set(zip(table["agent"], table["estimator"], strict=True)))
    assert len(views) >= 11, "five agents with two estimates each, and the ego's mission estimate"
    for agent, estimate in views:
        own = np.flatnonzero((table["agent"] == agent) & (table["estimator"] == estimate))
        own = own[np.lexsort((table["id"][own], table["kind"][own], table["frame"][own]))]
        shown, codes = rows_of_view(block, agent, estimate)
        kind = np.where(columns["box.truth"][shown] > 0, "truth", "track")
        order = np.lexsort((columns["box.id"][shown], kind, columns["box.frame"][shown]))
        shown, codes, kind = shown[order], codes[order], kind[order]
        assert np.array_equal(columns["box.frame"][shown], table["frame"][own])
        assert np.array_equal(columns["box.id"][shown], table["id"][own])
        assert np.array_equal(kind, table["kind"][own])
        meanings = np.array(header["meanings"])[codes - 1]
        for column, name in enumerate(("outcome", "cause", "by")):
            assert np.array_equal(meanings[:, column], table[name][own])
        for name in "xyzlwh":
            assert np.abs(columns[f"box.{name}"][shown] - table[name][own]).max() <= 0.005 + 1e-9
        assert np.abs(columns["box.yaw"][shown] - table["yaw"][own]).max() <= 0.001 + 1e-9


def test_matched_tracks_know_the_object_that_they_follow(block: Block, attacked_run: Path) -> None:
    header, columns = block
    table = read_table(attacked_run / "objects.parquet")
    matched = columns["matched"].reshape(-1, len(columns["box.frame"])) > 0
    ids = np.full(matched.shape, -1)
    ids[matched] = columns["match"]
    tracks = (table["kind"] == "track") & (table["outcome"] == "matched")
    assert matched.sum() == tracks.sum()
    row = next(v["row"] for v in header["views"] if (v["agent"], v["estimate"]) == ("ego", "picture"))
    own = tracks & (table["agent"] == "ego") & (table["estimator"] == "picture")
    expected = sorted(zip(table["frame"][own], table["id"][own], table["match_id"][own], strict=True))
    here = np.flatnonzero(matched[row])
    found = zip(columns["box.frame"][here], columns["box.id"][here], ids[row][here], strict=True)
    assert sorted(found) == expected


def test_velocities_and_covariances_come_from_the_messages(block: Block, loaded_run: Run) -> None:
    _, columns = block
    assert columns["box.known"].all(), "every track of this run was recorded"
    truth = columns["box.truth"] > 0
    recording = loaded_run.files.scene
    frames = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
    order, own = np.lexsort((recording.truth.id, frames)), np.lexsort((columns["box.id"], columns["box.frame"]))
    own = own[truth[own]]
    assert np.abs(columns["box.vx"][own] - recording.truth.velocity[order, 0]).max() <= 0.025 + 1e-9
    spread = columns["box.sx"][~truth]
    assert spread.min() > 0.0
    assert np.median(spread) < 2.0
    assert not columns["box.sx"][truth].any()


def test_manipulations_states_and_series_are_those_of_the_tables(block: Block, attacked_run: Path) -> None:
    header, columns = block
    attacks = read_table(attacked_run / "attacks.parquet")
    placed = np.isin(attacks["effect"], header["effects"])
    effect = np.array(header["effects"])[columns["effects.effect"].astype(int)]
    by = np.array(header["adversaries"])[columns["effects.by"].astype(int)]
    found = sorted(zip(columns["effects.frame"], effect, by, strict=True))
    expected = zip(attacks["frame"], attacks["effect"], attacks["interposer"], strict=True)
    assert found == sorted(each for each, wanted in zip(expected, placed, strict=True) if wanted)
    trust = read_table(attacked_run / "trust.parquet")
    frames = header["frames"]
    state = columns["agents.state"].reshape(-1, frames).astype(int)
    for row, agent in enumerate(header["agents"]):
        own = trust["agent"] == agent["name"]
        names = np.array(["", *header["states"]])[state[row] % 8]
        assert np.array_equal(names[trust["frame"][own]], trust["state"][own])
    lying = {agent["name"] for row, agent in enumerate(header["agents"]) if (state[row] & 16).any()}
    assert lying == {agent["name"] for agent in header["agents"] if agent["adversaries"]}
    counts = read_table(attacked_run / "metrics.parquet")
    row = header["series"].index({"agent": "ego", "estimate": "picture"})
    own = (counts["agent"] == "ego") & (counts["estimator"] == "picture")
    missed = counts["fn"][own][np.argsort(counts["frame"][own])]
    assert np.array_equal(columns["series.fn"].reshape(-1, frames)[row], missed)


def test_an_undecided_agent_keeps_its_state_while_it_lies_and_while_it_is_down(attacked_run: Path) -> None:
    run = Run(attacked_run)
    run.files.trust["state"] = np.full(len(run.files.trust["frame"]), "undecided", object)
    run.files.record["steps"] = [{"node": "infra_1", "frame": 30, "action": "stop"}]
    data = run_block(run)
    header, columns = unpack(data)
    state = columns["agents.state"].reshape(-1, header["frames"]).astype(int)
    judged = state[:, int(run.files.trust["frame"].min()) :]
    assert {header["states"][code - 1] for code in set((judged % 8).ravel().tolist())} == {"undecided"}
    (row,) = (index for index, agent in enumerate(header["agents"]) if agent["name"] == "infra_1")
    assert (state[row, 30:] & header["flags"]["down"]).all()
    assert not (np.delete(state, row, axis=0) & header["flags"]["down"]).any()
    assert (state[row] & header["flags"]["lying"]).any()


def test_columns_keep_their_numbers_within_half_their_resolution() -> None:
    rng = np.random.default_rng(1)
    packer, columns = Packer(), {}
    for name, scale, size in (("small", 1.0, 3.0), ("large", 0.01, 4e5), ("empty", 1.0, 0.0)):
        columns[name] = scale, rng.normal(0.0, size, 0 if name == "empty" else 200)
        packer.add(name, columns[name][1], scale=scale, differences=name != "small")
    _, found = unpack(packer.block({}))
    for name, (scale, values) in columns.items():
        assert found[name].shape == values.shape
        assert np.all(np.abs(found[name] - values) <= scale / 2 + 1e-9 * np.abs(values))
    with pytest.raises(ValueError, match=r"odd.*finite numbers"):
        packer.add("odd", np.array([np.nan]))


def test_ids_that_do_not_fit_are_shown_by_their_last_bits() -> None:
    ids = shown_id(np.array([7, -1, 2**30 - 1, 2**62 + 5, -(2**63)]))
    assert ids.tolist() == [7, -1, 2**30 - 1, 5, 0]
    packer = Packer()
    packer.add("box.id", ids)
    assert unpack(packer.block({}))[1]["box.id"].tolist() == ids.tolist()
