"""What attacks do to a driven car, and what defences spare it, from pairs of the same scene and seed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from defence_outcomes import outcome

import mast_zenoh as mast
from mast_zenoh.config.registry import parse_scene
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.metrics.study_results import Statistic
from mast_zenoh.show.tables.text_table import ResultTables
from mast_zenoh.study import definition
from mast_zenoh.study.defences.driving_matrix import (
    DRIVING_MEASURES,
    DrivingMatrix,
    DrivingRow,
    conclusion,
    driving_tables,
    headline,
)
from mast_zenoh.study.defences.kinds import Factors

SEEDS = 6
SIZE = "6 seeds \u00d7 1 scene"


def factors_of(attack: str, wire: str, defence: str) -> Factors:
    return Factors(attack=attack, wire=wire, defence=defence, car="ego")


def collection_of(cells: Iterable[Factors], scenes: Sequence[str], seeds: Sequence[int]) -> DrivingMatrix:
    return DrivingMatrix({label_of(cell): cell for cell in cells}, scenes, seeds)


def label_of(cell: Factors) -> str:
    return "{attack} {wire} {defence}".format_map(cell)


def tables_of(table: list[DrivingRow]) -> ResultTables:
    return driving_tables(table, SIZE)


def trial(
    cell: Factors,
    seed: int,
    collisions: int,
    needless: int,
    way_m: float,
    *,
    effects: Mapping[str, int] = MappingProxyType({"inserted": 80}),
    scene: str = "junction",
    **facts: int,
) -> Any:
    """A trial; on odd seeds the car drives 10 m further, and brakes needlessly once more, with or without an attack."""
    odd = seed % 2
    driven = {
        "collisions": [{"object": number} for number in range(collisions)],
        "needless_brakes": needless + odd,
        "missed_brakes": 0,
        "hard_brakes": 0,
        "progress_m": way_m + 10.0 * odd,
        "obeyed_commands": 70,
        "uncommanded_frames": 0,
        "blind_frames": 0,
        **facts,
    }
    interposers = {"adversary_1": {"role": "adversary", "effects": effects}} if cell["attack"] else {}
    interposers["link_1"] = {"role": "link", "effects": {}}
    metrics = {"driven": {"ego": driven}, "interposers": interposers, "defence": {}}
    return outcome(label_of(cell), scene, seed, metrics)


Facts = dict[str, int]


def table_of(
    happened: dict[tuple[str, str], tuple[int, int, float]],
    left_out: int = 0,
    facts: dict[tuple[str, str], Facts] | None = None,
    idle: tuple[str, ...] = (),
) -> list[DrivingRow]:
    """The table of (attack, defence) with (collisions, needless brakes, way); the last seeds are left out.

    facts: other numbers of the driven car, by attack and defence;  idle: attacks that change no message
    """
    cells = {key: factors_of(key[0], "picture" if key[0] else "", key[1]) for key in happened}
    collection = collection_of(cells.values(), ["junction"], range(SEEDS))
    for key, cell in cells.items():
        for seed in range(SEEDS - left_out):
            collisions, needless, way_m = happened[key]
            spread = seed % 3 if key[0] and not key[1] else 0  # so that differences vary from seed to seed
            effects = {"unsettled": 1} if key[0] in idle else {"inserted": 80}
            given = (facts or {}).get(key, {})
            collection.add(trial(cell, seed, collisions, needless + spread, way_m - spread, effects=effects, **given))
    return collection.table()


HAPPENED = {
    ("", ""): (0, 0, 100.0),
    ("", "veto"): (0, 0, 90.0),
    ("queue", ""): (0, 3, 40.0),
    ("queue", "veto"): (0, 0, 88.0),
    ("hidden", ""): (1, 0, 110.0),
    ("hidden", "veto"): (1, 0, 100.0),
}


def test_an_attack_is_compared_with_its_twin_and_a_defence_with_none() -> None:
    rows = {(row.of["attack"], row.of["defence"]): row for row in table_of(HAPPENED)}
    assert rows["", ""]["mean progress_m"].value == 105.0
    assert rows["queue", ""]["added progress_m"].value == -61.0
    assert rows["queue", "veto"]["added progress_m"].value == -2.0, "the twin has the same defence"
    assert rows["queue", "veto"]["spared progress_m"].value == 49.0, "the same seeds and attack without a defence"
    assert rows["", "veto"]["spared progress_m"].value == -10.0
    added = rows["queue", ""]["added needless_brakes"]
    assert 3.0 < added.low < added.value == 4.0 < added.high < 5.0
    assert rows["hidden", ""]["added collisions"].value == 1.0
    assert rows["", ""].of_kind("added") == {}
    assert rows["queue", ""].of_kind("spared") == {}


def test_the_conclusion_says_what_helps_what_does_not_and_what_was_not_run() -> None:
    text = " ".join(conclusion(table_of(HAPPENED)))
    assert "Without a defence, queue on picture adds 4.00 [" in text
    assert "veto helps against queue on picture (" in text
    assert "Without a defence, hidden on picture adds 1.00 (all equal) collisions, " in text
    assert "Not run" not in text
    assert "Not run: no attack, none; no attack, veto; " in " ".join(conclusion(table_of(HAPPENED, left_out=SEEDS)))


def test_harm_in_too_few_trials_is_neither_shown_nor_denied() -> None:
    text = " ".join(conclusion(table_of(HAPPENED, left_out=SEEDS - 2)))
    assert (
        "Without a defence, hidden on picture adds 1.00 (n < 5) collisions, 0.50 (n < 5) needless brakes: too few "
        "trials to tell." in text
    )
    assert "Too few trials to tell what veto changes for queue on picture; hidden on picture." in text
    assert "no harm" not in text


def test_harm_that_was_not_seen_has_a_bound_on_its_chance() -> None:
    cells = [(attack, defence) for defence in ("", "veto") for attack in ("", "calm")]
    table = table_of({("", ""): (1, 4, 50.0), ("", "veto"): (1, 4, 50.0), **dict.fromkeys(cells[1::2], (0, 0, 100.0))})
    bound = "in 6 of 6 pairs; its chance is below 46 % (exact, 95 %)"
    assert f"Without a defence, calm on picture did no harm that was seen, {bound}." in conclusion(table)
    assert headline(table) == "No attack did harm in any of 6 pairs"
    same = table_of({**dict.fromkeys(cells, (0, 0, 100.0)), ("calm", ""): (0, 0, 100.0)}, left_out=SEEDS - 1)
    one = "in 1 of 1 pair; its chance is below 98 % (exact, 95 %)"
    assert f"No change by veto was seen for calm on picture ({one})." in conclusion(same)


def test_harm_in_some_pairs_is_not_denied_where_the_mean_has_none() -> None:
    better_in_most = {("", ""): (0, 1, 100.0), ("mixed", ""): (0, 0, 101.0)}  # two brakes and 1 m less on two seeds
    table = table_of(better_in_most)
    assert "Without a defence, mixed on picture does harm in 2 of 6 pairs, and none in the mean." in conclusion(table)
    assert headline(table).endswith("or shortens the way in the mean")


def test_an_adversary_that_changed_no_message_is_named_first_and_never_called_harmless() -> None:
    cells = [(attack, defence) for defence in ("", "veto") for attack in ("", "idle")]
    happened = {**dict.fromkeys(cells, (0, 0, 100.0)), ("", ""): (0, 4, 50.0)}
    table = table_of(happened, idle=("idle",), left_out=1)
    first, *others = conclusion(table)
    assert (
        first == "In 5 of 5 runs each with idle on picture; idle on picture and veto, adversary_1 changed no message."
    )
    assert headline(table) == first.removesuffix(".")
    assert others == []
    tables = tables_of(table)
    assert tables.reading[0] == first, "on the page"
    assert tables.about.startswith(f"{SIZE}. {first}"), "in driving.md"
    assert tables.brief[0].about.startswith(first), "on the terminal"


@pytest.mark.parametrize(
    ("facts", "sentence"),
    [
        (dict(obeyed_commands=0, uncommanded_frames=69), "no command of the driver was accepted"),
        (dict(obeyed_commands=40, uncommanded_frames=9), "the car had no new command in some frames"),
        (dict(blind_frames=3), "the driver had no estimate in some frames"),
    ],
)
def test_a_car_whose_driver_did_not_drive_is_named_first_and_no_attack_on_it_is_harmless(
    facts: Facts, sentence: str
) -> None:
    calm = {("", ""): (1, 4, 50.0), ("calm", ""): (0, 0, 100.0)}
    attacked = table_of(calm, facts={("calm", ""): facts})
    assert conclusion(attacked)[0] == f"In 6 of 6 runs with calm on picture, {sentence}."
    assert headline(attacked) == f"In 6 of 6 runs with calm on picture, {sentence}"
    both = table_of(calm, facts=dict.fromkeys(calm, facts))
    assert conclusion(both)[0] == f"In all 12 runs, {sentence}."
    twin = table_of(calm, facts={("", ""): facts})
    for table in (attacked, both, twin):
        assert len(conclusion(table)) == 1, "nothing is said of the attack"


def test_the_seeds_or_where_they_are_few_the_scenes_are_the_units_of_intervals() -> None:
    """Five scenes with one seed each have the interval of five seeds of one scene; two by two have none."""
    cells = [factors_of("", "", ""), factors_of("queue", "picture", "")]

    def added(scenes: list[str], seeds: int) -> Statistic:
        collection = collection_of(cells, scenes, range(seeds))
        for number, (scene, seed) in enumerate(product(scenes, range(seeds))):
            collection.add(trial(cells[0], seed, 0, 0, 100.0, scene=scene))
            collection.add(trial(cells[1], seed, 0, 1 + number, 100.0, scene=scene))
        return collection.table()[1]["added needless_brakes"]

    by_seed, by_scene = added(["a"], 5), added(["a", "b", "c", "d", "e"], 1)
    assert (by_seed.low, by_seed.high) == (by_scene.low, by_scene.high)
    half = 2.776 * np.sqrt(2.5 / 5.0)  # Student's t of four degrees of freedom, values 1 to 5
    assert (by_seed.low, by_seed.high) == pytest.approx((3.0 - half, 3.0 + half), abs=1e-3)
    assert np.isnan(added(["a", "b"], 2).low)


def test_differences_that_are_mostly_zero_have_a_share_and_count_only_by_their_signs() -> None:
    """A collision in five of 20 pairs is no proof of more, in six it is (exact sign test: 0.0625, 0.031)."""
    for hit, shown in ((5, False), (6, True)):
        cells = [factors_of("", "", ""), factors_of("hidden", "picture", "")]
        collection = collection_of(cells, ["junction"], range(20))
        for seed in range(20):
            collection.add(trial(cells[0], seed, 0, 0, 100.0))
            collection.add(trial(cells[1], seed, int(seed < hit), 0, 100.0))
        table = collection.table()
        assert table[1]["added collisions"].differs is shown
        assert np.isnan(table[1]["added collisions"].low)
        (text,) = conclusion(table)
        share = {5: "0.25 collisions (0 in 75 % [51, 91] of the pairs)", 6: "0.30 collisions (0 in 70 % [46, 88] of "}
        assert f"hidden on picture adds {share[hit]}" in text
        assert text.endswith("too few trials to tell.") is not shown


def test_without_a_defence_there_is_no_table_of_what_it_changes() -> None:
    titles = [each.title for each in tables_of(table_of({key: HAPPENED[key] for key in HAPPENED if not key[1]})).tables]
    assert titles == ["What the car did", "What the attack adds to what the car did"]


def test_the_headline_names_the_clearest_effect_and_what_is_equal_in_all_seeds_without_any() -> None:
    no_attack = {("", ""): (0, 0, 100.0)}
    clear = "The attack queue on picture changes the way driven by \u221261.00 ["
    assert headline(table_of(HAPPENED)).startswith(clear), "not the collisions, which are without spread"
    hidden = {key: HAPPENED[key] for key in HAPPENED if key[0] != "queue" and key[1]} | no_attack
    all_equal = "The attack hidden on picture, with veto, adds 1.00 (all equal) collisions a trial"
    assert headline(table_of(hidden)) == all_equal
    queue = headline(table_of({**no_attack, ("queue", ""): (0, 3, 40.0)}))
    assert queue.startswith(clear)
    slow = headline(table_of({**no_attack, ("", "veto"): (0, 0, 100.0), ("slow", "veto"): (0, 0, 40.0)}))
    assert slow == "The attack slow on picture, with veto, changes the way driven by \u221260.00 (all equal) m a trial"
    few = headline(table_of(HAPPENED, left_out=SEEDS - 2))
    assert few == "The attack hidden on picture adds 1.00 (n < 5) collisions a trial: too few trials to tell"
    good = {**no_attack, ("", "veto"): (0, 0, 100.0), ("good", "veto"): (0, 0, 120.0)}
    assert headline(table_of(good)) == "No attack did harm in any of 6 pairs"
    assert headline(table_of(no_attack)) == ""


def test_the_headline_is_never_an_unclear_effect_beside_a_clear_one() -> None:
    """A collision in one pair of six is no proof; 61 m less in all of them are."""
    cells = [factors_of("", "", ""), factors_of("queue", "picture", "")]
    collection = collection_of(cells, ["junction"], range(SEEDS))
    for seed in range(SEEDS):
        collection.add(trial(cells[0], seed, 0, 0, 100.0))
        collection.add(trial(cells[1], seed, int(seed == 0), 0, 40.0 - seed))
    table = collection.table()
    assert headline(table).startswith("The attack queue on picture changes the way driven by \u221262.50 [\u2212")
    assert table[1]["added progress_m"].p < 0.05 < table[1]["added collisions"].p


def test_a_users_metric_is_in_the_table_and_the_csv_with_its_difference_from_the_twin() -> None:
    cells = [factors_of("", "", ""), factors_of("queue", "picture", "")]
    collection = collection_of(cells, ["junction"], range(SEEDS))
    for attacked, cell in enumerate(cells):
        for seed in range(SEEDS):
            each = trial(cell, seed, 0, 0, 100.0)
            each.metrics["agents"] = {
                "ego": {"mission": {"fn": {"mean": 1.0, "std": 0.0}, "half": 2.0 + 3.0 * attacked}}
            }
            collection.add(each)
    tables = tables_of(collection.table())
    (own,) = [each for each in tables.tables if each.title == "Your metrics"]
    assert own.lines[1][-2:] == ["5.00 (all equal)", "3.00 (all equal)"]
    assert "queue,picture,none,added half,3.0," in tables.as_csv()


def test_trials_that_are_missing_are_counted_and_their_pairs_left_out() -> None:
    table = table_of(HAPPENED, left_out=1)
    assert {row.trials for row in table} == {SEEDS - 1}
    means = [line.split(",")[-2:] for line in tables_of(table).as_csv().splitlines() if ",mean " in line]
    assert {tuple(each) for each in means} == {("5", "0")}


def test_tables_and_a_figure_are_written(tmp_path: Path) -> None:
    for left_out in (0, SEEDS):
        table = table_of(HAPPENED, left_out)
        texts = tables_of(table).texts("driving")
        assert "| queue | picture | veto | " in texts["driving.md"]
        assert "hidden,picture,none,mean collisions," in texts["driving.csv"]
        collection_of([], ["junction"], range(SEEDS)).figures(table)["driving"].save(tmp_path)
        assert (tmp_path / "driving.pdf").stat().st_size > 5_000


def test_the_shipped_study_pairs_every_attack_with_every_defence() -> None:
    study = definition.load("driving", ["attacks=cut_in@tracks,hidden_leader@detections+picture", "defences=none,veto"])
    assert [(cell["attack"], cell["wire"], cell["defence"]) for cell in study.factors.values()] == [
        (attack, wire, defence)
        for defence in ("", "veto")
        for attack, wire in (("", ""), ("cut_in", "tracks"), ("hidden_leader", "detections picture"))
    ]
    full = definition.load("driving")
    assert len(full.scenes) * (full.trials or 0) == 30, "pairs of each attack and defence"
    for scene in full.scenes:
        refuse_calibration_data([full.seed], parse_scene(scene.label), "the study of driving")


def test_an_attack_without_its_wire_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match=r"attacks: found 'cutt_in'.*cut_in@"):
        definition.load("driving", ["attacks=cutt_in"])


def test_the_name_of_an_attack_alone_stands_for_its_first_wire() -> None:
    study = definition.load("driving", ["attacks=phantom_queue", "defences=none"])
    assert [configuration.label for configuration in study.configurations] == [
        "no attack, no defence",
        "phantom_queue on picture, no defence",
    ]


@pytest.mark.parametrize(("name", "hint"), [("vetto", "did you mean 'veto'"), ("xyz", "known: .*none, veto")])
def test_an_unknown_defence_is_named_with_those_of_the_study(name: str, hint: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"defences: no defence '{name}'; {hint}"):
        definition.load("driving", [f"defences=none,{name}"])


@pytest.mark.heavy
def test_the_study_finds_that_own_sensors_protect_from_a_phantom_queue(tmp_path: Path) -> None:
    """Three seeds of one junction: a single one may differ between processors. The veto needs no other defence."""
    finished = mast.study(
        "driving",
        out=tmp_path / "study",
        trials=3,
        jobs=1,
        scenes="intersection:6",
        attacks="phantom_queue@picture",
        defences="none,veto",
    )
    text = (finished.path / "driving.csv").read_text()
    lines = [line.split(",") for line in text.splitlines()[1:]]
    values = {(line[0], line[2], line[3]): float(line[4]) for line in lines}
    assert set(DRIVING_MEASURES) == {name.removeprefix("mean ") for *_, name in values if name.startswith("mean ")}
    assert values["phantom_queue", "none", "added progress_m"] < -5.0
    assert values["phantom_queue", "veto", "spared progress_m"] > 5.0
    means = [values["phantom_queue", defence, "mean needless_brakes"] for defence in ("veto", "none")]
    assert means[0] < means[1]
    assert (finished.path / "driving.png").stat().st_size > 10_000
    assert "<h1>The attack phantom_queue on picture " in (finished.path / "report.html").read_text()
