"""The public names are pinned: changing them is a decision (docs/stability.md)."""

import inspect
import pkgutil
import subprocess
import sys

import pytest
from surface import BASE_CLASSES, OF_A_RUN

import mast_zenoh as mast
from mast_zenoh.study.interface import carry_out

NAMES = {
    *("run", "open", "study", "compare", "list", "scene", "__version__"),
    *("PreparedScene", "Run", "Comparison", "FinishedStudy", "Listing", "MastError"),
}
_BASES = """
    node.Node node.Source messages.Schema messages.Column attacks.Attack attacks.Coordination attacks.Selection
    attacks.Propagation attacks.Imitation attacks.AdaptiveAttack attacks.FollowingEgo attacks.FalseTraffic
    driving.Driver tracking.Tracker tracking.Assignment fusion.pipelines.Pipeline fusion.Clusterer
    fusion.Fusion fusion.GroupTracker integrity.Integrity scenes.Scene scenes.Sensor sensing.Detector
    metrics.FrameMetric metrics.RunMetric metrics.Assigner links.Rule faults.Fault launch.engine.Engine
    launch.checks.RunCheck show.RunFigure v2x.GenerationRules v2x.RedundancyRule v2x.CongestionControl v2x.CamGeneration
    v2x.RadioChannel attacks.PointAttack attacks.point_attacks.AttackedScan sensing.PointDetector sensing.PointCheck
"""
BASES = {f"mast_zenoh.{place}" for place in _BASES.split()}
MEMBERS = {
    "Comparison": "table headline plot markdown",
    "FinishedStudy": "table comparison results frames",
    "PreparedScene": "name agents agent truth save save_detections description birdseye",
    "Listing": "names groups index count",
}
KEYWORDS = {
    "run": "scenario frames seed out runtime mode rate record report endpoint secure allow_failures allow_churn",
    "study": "study trials candidates jobs cluster resume frames seed runtime out allow_failures record",
    "open": "path",
    "compare": "runs",
    "list": "kind",
    "scene": "scene seed frames",
}


def test_names_of_the_package_are_pinned() -> None:
    assert set(mast.__all__) == NAMES
    assert set(dir(mast)) >= NAMES
    for name in NAMES:
        assert getattr(mast, name) is not None


def test_base_classes_are_pinned() -> None:
    assert {place for places in BASE_CLASSES.values() for place in places} == BASES
    for place in BASES:
        cls = pkgutil.resolve_name(place)
        assert inspect.isclass(cls)
        assert cls.__doc__


@pytest.mark.parametrize("name", MEMBERS)
def test_members_of_returned_objects_are_pinned(name: str) -> None:
    assert {member for member in dir(getattr(mast, name)) if not member.startswith("_")} == {*MEMBERS[name].split()}


def test_members_of_a_run_are_pinned() -> None:
    assert " ".join(sorted(OF_A_RUN)) == (
        "agent agents animate attacks driven driving export findings headline id messages metrics name objects "
        "picture plot record report running seed snapshot status summary targets trust trust_objects truth"
    )
    assert {*OF_A_RUN} <= {*dir(mast.Run)}


@pytest.mark.parametrize("name", KEYWORDS)
def test_keywords_of_functions_are_pinned(name: str) -> None:
    function = carry_out if name == "study" else getattr(mast, name)
    taken = inspect.signature(function).parameters.values()
    assert [each.name for each in taken if each.kind is not each.VAR_KEYWORD] == KEYWORDS[name].split()


def test_importing_the_package_loads_none_of_its_other_modules() -> None:
    code = "import sys; before = set(sys.modules); import mast_zenoh; print(*sorted(set(sys.modules) - before))"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = process.stdout.split()
    assert [name for name in loaded if name.startswith("mast_zenoh")] == ["mast_zenoh"]
    assert not {"numpy", "pyarrow", "matplotlib", "typing"} & set(loaded)


def test_the_study_package_is_callable_however_it_was_imported() -> None:
    code = "import mast_zenoh.study.definition, mast_zenoh as mast; mast.study('nosuch')"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "ConfigurationError: nosuch: no" in process.stderr
