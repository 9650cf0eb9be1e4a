"""Everything that a scenario can name is listed with parameters and units."""

import inspect
import pkgutil
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import mast_zenoh as mast
from mast_zenoh import attacks, links, sensing
from mast_zenoh.api.catalogue import KINDS, Entry, described, unit_of
from mast_zenoh.cli.app import app
from mast_zenoh.config import bundle, registry
from mast_zenoh.faults.network import HOST_FAULTS
from mast_zenoh.messages.schemas import BUILT_IN
from mast_zenoh.metrics.measures import MEASURES

_BASES = """
    attacks: attacks.Attack attacks.Coordination attacks.Selection attacks.Propagation attacks.Imitation \
        attacks.Spoofer
    trackers: fusion.pipelines.AgentPipeline tracking.Tracker tracking.Assignment
    fusion: fusion.pipelines.MissionEstimator fusion.pipelines.Pipeline fusion.Clusterer fusion.Fusion \
        fusion.GroupTracker
    defences: integrity.Integrity sensing.PointCheck
    scenes: scenes.Scene sensing.Detector sensing.PointDetector sensing.Returns sensing.Clutter
    links: links.Rule
    faults: faults.Fault
    metrics: metrics.Metric metrics.Assigner
    drivers: driving.Driver driving.CarLimits
    rules: v2x.GenerationRules
    redundancy: v2x.RedundancyRule
    congestion: v2x.CongestionControl
    channel: v2x.RadioChannel v2x.OfdmTiming v2x.BackgroundStations
    awareness: v2x.CamGeneration v2x.Vehicle
"""
BASES: dict[str, list[type]] = {
    kind.strip(): [pkgutil.resolve_name(f"mast_zenoh.{name}") for name in names.split()]
    for kind, names in (line.split(":") for line in _BASES.strip().splitlines())
}


def shipped_entries(kind: str) -> list[Entry]:
    """The entries of a kind, without classes and message types defined by other tests."""
    classes = {name: cls for base in BASES.get(kind, ()) for name, cls in registry.known_types(base).items()}
    foreign = {name for name, cls in classes.items() if not cls.__module__.startswith("mast_zenoh.")}
    if kind == "messages":
        foreign = {entry.name for entry in mast.list(kind)} - set(BUILT_IN)
    return [entry for entry in mast.list(kind) if entry.name not in foreign]


@pytest.mark.parametrize("kind", KINDS)
def test_every_entry_has_a_description(kind: str) -> None:
    entries = shipped_entries(kind)
    assert entries
    for entry in entries:
        assert 15 < len(entry.description) < 250, f"{entry.name}: {entry.description!r}"
        assert not re.match(r"(See |`?[a-z_]+`?: )", entry.description), f"{entry.name}: {entry.description!r}"
        for parameter in entry.parameters:
            place = f"{kind}: {entry.name}.{parameter.name}"
            assert parameter.words or parameter.kind, f"{place} is not described in the docstring"
            assert not re.search(r"(^|; )[a-z]\w*_\w+: ", parameter.words), f"{place}: {parameter.words!r}"


@pytest.mark.parametrize(("kind", "bases"), BASES.items())
def test_every_class_is_listed_with_all_its_parameters(kind: str, bases: list[type]) -> None:
    listing = mast.list(kind)
    for base in bases:
        for name, cls in registry.known_types(base).items():
            signature = inspect.signature(cls).parameters
            taken = [name for name, each in signature.items() if each.kind is not each.VAR_KEYWORD]
            entries = [entry for entry in listing if entry.name == name]
            assert taken in [[parameter.name for parameter in entry.parameters] for entry in entries]


def test_what_the_scenario_spoofed_can_name_is_listed() -> None:
    """Its attacks, places of spoofers, checks, detectors, clutter and lidars."""
    listed = {kind: set(mast.list(kind).names) for kind in ("attacks", "defences", "scenes")}
    accepted = {
        "attacks": (attacks.Attack, attacks.Spoofer),
        "defences": (sensing.PointCheck,),
        "scenes": (sensing.PointDetector, sensing.Clutter),
    }
    for kind, bases in accepted.items():
        for base in bases:
            assert set(registry.known_types(base)) <= listed[kind]
    assert set(sensing.MODELS) <= listed["scenes"]
    assert "32 channels from -25° to 15°, 1800 azimuths in 360°, 200 m" in mast.list("scenes")["VLP-32C"].description


def test_entries_without_a_class_are_listed_too() -> None:
    assert set(links.PROFILES) <= set(mast.list("links").names)
    assert set(HOST_FAULTS) <= set(mast.list("faults").names)
    assert MEASURES.keys() <= set(mast.list("metrics").names)
    assert mast.list("codecs").names == ("cpm", "cam")
    for kind in ("scenarios", "studies"):
        assert [f"{name}.py" for name in mast.list(kind).names] == bundle.names(kind)


def test_units_come_from_names_and_descriptions() -> None:
    for name, meaning, unit in (
        ("start_s", "", "s"),
        ("sigma_mps2", "", "m/s²"),
        ("bits_per_s", "", "bit/s"),
        ("bit_rate_mbps", "", "Mbit/s"),
        ("power_dbm", "", "dBm"),
        ("yaw_noise_deg", "", "°"),
        ("box", "m, length, width and height", "m"),
        ("at", "s of scene time; it begins", "s"),
        ("until", "s of scene time", "s"),
        ("region", "where they are put", ""),
        ("copies", "how many more", ""),
    ):
        assert unit_of(name, meaning) == unit


def test_parameter_descriptions_are_read_from_lines_and_from_sentences() -> None:
    text = """Does it. count: how many.

    first, second: of both
                   and more
    third: of one; fourth: of another
    The rest is prose: it is left out.

    start_…, gate_m: m, of all that begin so
    """
    names = ["count", "first", "second", "third", "fourth", "start_a", "start_b", "gate_m", "other"]
    assert described(text, names) == {
        "count": "how many",
        "first": "of both and more",
        "second": "of both and more",
        "third": "of one",
        "fourth": "of another",
        "start_a": "m, of all that begin so",
        "start_b": "m, of all that begin so",
        "gate_m": "m, of all that begin so",
    }


def test_listings_show_defaults_units_and_descriptions() -> None:
    listing = " ".join(str(mast.list("scenarios")["coordinated"]).split())
    assert "attack_start_s = 4.0 s" in listing
    assert "coordinator selects new" in listing, "has its own description"
    assert "mean number added" in listing, "has the description of `uncoordinated`"
    listing = str(mast.list("faults")["Pause"])
    assert "until (s), required" in listing


def test_message_types_are_listed_with_dtypes_shapes_and_units() -> None:
    printed = str(mast.list("messages")["detections"])
    assert re.search(r"position: float64.*3", printed)
    assert "required" not in printed


def test_a_file_of_the_user_can_be_listed(tmp_path: Path) -> None:
    (tmp_path / "listed.py").write_text(
        "from mast_zenoh.messages import Column, Schema\n"
        "from mast_zenoh.node import Node\n\n"
        "class Gauge(Node):\n"
        "    role = 'gauge'\n"
        "    outputs = {'rain': Schema('rain', 2, 'rain as it falls', (Column('rate', 'float64', (1,), 'mm/h'),))}\n"
    )
    done = CliRunner().invoke(app, ["list", "messages", "rain", "--file", str(tmp_path / "listed.py")])
    assert done.exit_code == 0
    assert done.stdout.split("\n")[:3] == ["rain", "  Rain as it falls (version 2)", "    rate: float64 (1) mm/h"]
