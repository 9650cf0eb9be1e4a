"""Scenarios are files of plain dicts; errors are reported before the start."""

import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.attacks import PassThrough
from mast_zenoh.config import bundle, loading, settings
from mast_zenoh.config.resolved import Resolved, build_node
from mast_zenoh.errors import ConfigurationError, MastError, NodeFileError, WiringError
from mast_zenoh.scenario import load, resolve
from mast_zenoh.wiring.model import Wiring

TINY = dict(type="TinyScene", n_infrastructure=2)
TRACKER = dict(type="KalmanBoxTracker3D")
AGENT = dict(pipeline=dict(type="AgentPipeline", tracker=TRACKER, mission=dict(type="PictureFirst")))

#: The configuration listing of the paper, unchanged.
LISTING = """
commandcenter = dict(type="CommandCenter", pipeline=dict(type="CommandCenterPipeline",
    clustering=dict(type="SampledAssignmentClusterer", assign_radius=2.0),
    group_tracking=dict(type="GroupTrackerWrapper", fusion=dict(type="CovarianceIntersectionFusion"),
        tracker=dict(type="KalmanBoxTracker3D"))))
"""
SCENARIO_BODY = f"""
def scenario(n=3, rate=1.0, on=True, name="mine", free=None, places=(1.0, 2.0)):
    return dict(
        name=name,
        scene={TINY!r},
        agents={{"*": {AGENT!r}}},
        %s=commandcenter,
        evaluator=dict(scorer=dict(type="Scorer", range_m=50.0 * n)),
    )
"""


def write_scenario(folder: Path, text: str, name: str = "mine.py") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def paper_scenario(folder: Path, key: str = "command_center") -> str:
    """A user-defined scenario file."""
    return write_scenario(folder, LISTING + SCENARIO_BODY % key)


def resolved(name: str, *settings: str, frames: int = 2) -> Resolved:
    path, content = load(name, settings)
    return resolve(path, content, frames=frames)


# -- settings --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("n=5", {"n": 5}),
        ("rate=2", {"rate": 2.0}),
        ("rate=0.5", {"rate": 0.5}),
        ("on=false", {"on": False}),
        ("on=True", {"on": True}),
        ("name=3", {"name": "3"}),
        ("name=a=b", {"name": "a=b"}),
        ("name=", {"name": ""}),
        ("free=none", {"free": None}),
        ("free=7", {"free": 7}),
        ("free=[1, 2]", {"free": [1, 2]}),
        ("free=a word", {"free": "a word"}),
        ("places=[3.0]", {"places": [3.0]}),
        ("places=3.0", {"places": [3.0]}),
        ("places=infra_1", {"places": ["infra_1"]}),
        ("places=[]", {"places": []}),
    ],
)
def test_a_launch_time_parameter_has_the_type_of_its_default(
    tmp_path: Path, setting: str, expected: dict[str, Any]
) -> None:
    _, function = loading.function("scenarios", paper_scenario(tmp_path), "scenario")
    parameters, dotted = settings.split([setting], function, "mine.py")
    assert parameters == expected
    assert [type(value) for value in parameters.values()] == [type(value) for value in expected.values()]
    assert dotted == {}


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("n=many", r"mine.py: --set.*'many'"),
        ("n=2.5", r"'2.5'.*int"),
        ("n=True", r"'True'.*int"),
        ("rate=fast", r"'fast'.*float.*1.0"),
        ("rate=True", r"'True'.*float"),
        ("on=1", r"'1'.*bool"),
        ("places={}", r"'\{\}'.*list"),
        ("nn=3", r"mine.py: --set.*'n'"),
        ("nam=x", "mean 'name'"),
        ("n", r"--set n.*KEY=VALUE"),
        ("", "expected KEY=VALUE"),
        ("=3", r"no.*launch-time parameter"),
        ("command_center.pipelin.x=1", "--set command_center.pipelin.x: .*'pipeline'"),
        ("comand_center.pipeline=1", r"no 'comand_center'.*'command_center'"),
        ("name.x=1", r"name.*'mine'.*dict"),
        ("name.x.y=1", "no 'x' there"),
        ("agents.ego.pipelin.frame=body", "no 'pipelin' there; .*'pipeline'"),
        ("agents.infra_9.pipeline.frame=body", r"agents.infra_9.pipeline.frame.*agent 'infra_9'"),
        ("agents.car_*.pipeline.frame=body", r"agent 'car_\*'.*scene"),
        ("command_center.pipeline.clustering.asign_radius=3.0", "mine.py: .*'assign_radius'"),
        ("run.sed=3", r"mine.py: run.sed.*'seed'"),
        ("scene.n_infra=3", r"mine.py: scene\.n_infra.*'n_infrastructure'"),
        ("keyexpr.rewrite=[]", r"mine.py: keyexpr.rewrite.*'rewrites'"),
        ("evaluator.scorer.range_m=far", r"mine.py: evaluator\.scorer\.range_m.*'far'"),
        ("broker.latency=1.0", r"mine.py: broker\.latency.*'latency_s'"),
    ],
)
def test_an_invalid_setting_or_dotted_key_is_refused_with_its_path_and_the_nearest_name(
    tmp_path: Path, setting: str, reason: str
) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        resolved(paper_scenario(tmp_path), setting)


def value_at(content: Any, path: str) -> Any:
    for step in filter(None, path.split(".")):
        content = content[step]
    return content


@pytest.mark.parametrize("spelling", ["commandcenter", "command_center"])
@pytest.mark.parametrize("key", ["commandcenter", "command_center"])
def test_a_dotted_key_sets_a_value_in_the_scenario(tmp_path: Path, key: str, spelling: str) -> None:
    _, content = load(
        paper_scenario(tmp_path, key), [f"{spelling}.pipeline.clustering.assign_radius=3.5", "run.seed=4"]
    )
    assert value_at(content, "command_center.pipeline.clustering.assign_radius") == 3.5
    assert value_at(content, "command_center.pipeline.group_tracking.tracker.type") == "KalmanBoxTracker3D"
    assert content["run"] == {"seed": 4}, "a missing section is created"


def test_a_setting_of_one_agent_leaves_the_others_as_they_are() -> None:
    """The entry for all agents is copied for the agent that a setting names, whatever the order of the settings."""
    own = ["agents.infra_1.pipeline.tracker.type=IMMBoxTracker", "agents.*.status_every=3"]
    _, plain = load("baseline")
    _, content = load("baseline", own)
    agents = content["agents"]
    assert value_at(agents, "infra_1.pipeline.tracker.type") == "IMMBoxTracker"
    assert agents["infra_1"]["status_every"] == 3, "what is set for all holds for it, too"
    assert agents["*"] == plain["agents"]["*"] | {"status_every": 3}


def test_a_setting_of_a_pattern_of_agents_holds_for_all_that_match() -> None:
    path, content = load("baseline", ["agents.infra_*.pipeline.mission.radius=3.5"])
    nodes = scenario.resolve(path, content, frames=1).nodes
    radii = {name: value_at(nodes[name].config, "pipeline.mission.radius") for name in ("ego", "infra_1", "infra_2")}
    assert radii == {"ego": 2.0, "infra_1": 3.5, "infra_2": 3.5}


def test_a_dotted_key_changes_a_part_of_the_scenes_default_detector() -> None:
    def detector(*settings: str) -> dict[str, Any]:
        path, content = load("baseline", settings)
        detector: dict[str, Any] = resolve(path, content, frames=1).scene["detector"]
        return detector

    assert detector("scene.detector.white=true") == {"type": "DetectionModel", "white": True}
    assert detector("scene.detector.type=LastingErrors") == {"type": "LastingErrors"}
    whole = 'scene.detector={"type": "DetectionModel", "clutter_rate": 5.0}'
    parts = "scene.detector.clutter_rate=5.0", "scene=intersection:3"
    assert detector(whole) == detector(*parts) == {"type": "DetectionModel", "clutter_rate": 5.0}
    with pytest.raises(ConfigurationError, match=r"scene\.detector\.whit: .*'white'"):
        detector("scene.detector.whit=true")


def test_a_dotted_key_reaches_into_a_list(tmp_path: Path) -> None:
    text = "def scenario():\n    return dict(faults=[dict(at=1.0), dict(at=2.0)], nodes=dict(n=dict(gains=(1, 2))))\n"
    file = write_scenario(tmp_path, text)
    _, content = load(file, ["faults.1.at=3.0", "nodes.n.gains.0=5"])
    assert content["faults"] == [{"at": 1.0}, {"at": 3.0}]
    assert content["nodes"]["n"]["gains"] == [5, 2]
    with pytest.raises(ConfigurationError, match=r"--set faults\.2\.at.*'2'"):
        load(file, ["faults.2.at=3.0"])


def test_another_tracker_of_one_agent_changes_no_message_of_the_others() -> None:
    """Except what comes from the picture, which the tracks of all agents make."""

    def messages(*settings: str) -> dict[str, Any]:
        path, content = load("baseline", ["n_infrastructure=2", *settings])
        return Run(scenario.resolve(path, content, frames=10)).messages

    plain, other = messages(), messages("agents.infra_1.pipeline.tracker.type=FilterpyBoxTracker3D")
    assert plain.keys() == other.keys()
    for key in plain:
        if not key.startswith(("agent/infra_1/", "cc/")) and not key.endswith("/mission"):
            assert other[key] == plain[key], key
    assert other["agent/infra_1/tracks"] != plain["agent/infra_1/tracks"]


def test_a_setting_changes_only_one_node(tmp_path: Path) -> None:
    """Scenario files may use one dict in many places; shipped ones do."""
    for _ in range(2):
        _, content = load("uncoordinated", ["adversaries.adversary_1.attack.start_s=1.0", "agents.*.status_every=3"])
        starts = [value_at(content, f"adversaries.adversary_{i}.attack.start_s") for i in (1, 2)]
        assert starts == [1.0, 4.0]
    _, content = load("uncoordinated")
    assert value_at(content, "adversaries.adversary_1.attack.start_s") == 4.0, "also not for the next call"
    assert "status_every" not in content["agents"]["*"]


# -- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(Path(name).stem for name in bundle.names("scenarios")))
def test_shipped_scenarios_resolve(name: str) -> None:
    _, function = loading.function("scenarios", name, "scenario")
    numbers = {"n_infrastructure": 2, "n_mobile": 0}
    path, content = load(name, [f"{k}={v}" for k, v in numbers.items() if k in inspect.signature(function).parameters])
    resolved_scenario = resolve(path, content, frames=1)
    roles = [spec.role for spec in resolved_scenario.nodes.values()]
    assert roles[0] == "simulator"
    assert roles.count("agent") == (3 if "n_infrastructure" in inspect.signature(function).parameters else 5)
    assert roles.count("evaluator") == 1
    central = 0 if "peer" in roles else 1
    assert roles.count("broker") == roles.count("command_center") == central
    wired = {name for wire in resolved_scenario.wiring["wires"] for name in nodes_on(wire)}
    assert resolved_scenario.nodes.keys() == wired | {end["node"] for end in resolved_scenario.wiring["overhearers"]}


def nodes_on(wire: dict[str, Any]) -> set[str]:
    return {wire["publisher"], *wire["subscribers"], *wire["interposers"]}


@pytest.mark.parametrize("name", ["uncoordinated", "coordinated"])
def test_the_number_of_adversaries_is_a_launch_time_parameter(name: str) -> None:
    for n in (0, 1, 3):
        resolved_scenario = tiny(name, f"n_adversaries={n}", infrastructure=3, frames=1)
        assert [spec.config["agent"] for spec in resolved_scenario.nodes.values() if spec.role == "adversary"] == [
            f"infra_{i + 1}" for i in range(n)
        ]


def test_a_node_file_next_to_the_scenario_overrides_the_shipped_one(tmp_path: Path) -> None:
    shipped = (bundle.ROOT / "nodes" / "broker.py").read_text()
    (tmp_path / "broker.py").write_text(
        shipped.replace("class Broker(", "class MyBroker(").replace("main(Broker)", "main(MyBroker)")
    )
    resolved_scenario = resolved(paper_scenario(tmp_path))
    assert resolved_scenario.nodes["broker"].type == "MyBroker"
    assert resolved_scenario.nodes["broker"].file == str(tmp_path / "broker.py")
    assert resolved_scenario.nodes["command_center"].file == str(bundle.ROOT / "nodes" / "command_center.py")


OWN_ALGORITHMS = """
from mast_zenoh.attacks import Attack, Tampering
from mast_zenoh.scenes import Scene
from mast_zenoh.tracking import KalmanBoxTracker3D
from tiny_world import TinyScene

class Shy(Attack):
    def __init__(self, *, shyness: float = 1.0) -> None:
        self.shyness = shyness

    def step(self, frame, time_ns, objects, agent_position, directive=None):
        return Tampering.nothing(len(objects))

class MyTracker(KalmanBoxTracker3D):
    def __init__(self, *, twice: bool = False) -> None:
        super().__init__()
        self.twice = twice
"""


def test_user_defined_algorithms_can_be_named_by_type(tmp_path: Path) -> None:
    text = (
        OWN_ALGORITHMS
        + LISTING.replace('type="KalmanBoxTracker3D"', 'type="MyTracker", twice=True')
        + (
            "def scenario():\n"
            f"    return dict(scene={TINY!r}, agents={{'*': {AGENT!r}}}, commandcenter=commandcenter,\n"
            "        evaluator=dict(scorer=dict(type='Scorer')), keyexpr=dict(rewrites=['on_detections.toml']),\n"
            "        adversaries=dict(eve=dict(agent='infra_1', attack=dict(type='Shy', shyness=2))))\n"
        )
    )
    resolved_scenario = resolved(write_scenario(tmp_path, text))
    assert build_node(resolved_scenario.nodes["eve"], "eve").attack.shyness == 2.0
    assert resolved_scenario.modules == (str(tmp_path / "mine.py"),), "for the nodes' processes"
    assert tiny().modules == ()
    run = Run(resolved_scenario)
    assert not run.failures
    assert type(run.nodes["command_center"].pipeline.group_tracking.tracker).__name__ == "MyTracker"


OWN_PIPELINE = """
import numpy as np

from mast_zenoh.fusion.pipelines import Pipeline

class OneAgent(Pipeline):
    def __init__(self, *, believed: str) -> None:
        self.believed = believed

    def step(self, time_ns, states, agent, agents, weights=None):
        theirs = states.select(agent == agents.index(self.believed)) if self.believed in agents else states.select([])
        in_order = theirs.select(np.argsort(theirs.id))
        return in_order, np.ones(len(in_order), np.int64)

    def reset(self) -> None:
        pass
"""


def test_the_command_centre_takes_a_user_defined_pipeline(tmp_path: Path) -> None:
    text = OWN_PIPELINE + SCENARIO_BODY.replace(
        "=commandcenter", "=dict(pipeline=dict(type='OneAgent', believed='infra_2'))"
    )
    resolved_scenario = resolved(write_scenario(tmp_path, text % "command_center"), frames=6)
    run = Run(resolved_scenario)
    assert not run.failures
    pictures = run.decoded("cc/picture", "picture")
    tracks = run.decoded("agent/infra_2/tracks", "tracks")
    assert sum(len(message.body["id"]) for message in tracks) > 0
    for picture, collated in zip(pictures, tracks, strict=True):
        np.testing.assert_array_equal(picture.body["id"], np.sort(collated.body["id"]))


def test_a_user_defined_algorithm_may_be_in_the_file_of_a_user_defined_node(tmp_path: Path) -> None:
    shipped = (bundle.ROOT / "nodes" / "adversary.py").read_text()
    own = OWN_ALGORITHMS.split("class MyTracker")[0]
    head, main = shipped.split('if __name__ == "__main__"')
    (tmp_path / "shy_adversary.py").write_text(
        head + own.replace("from __future__", "#") + "\n\nif __name__ == '__main__'" + main
    )
    text = LISTING + (
        "def scenario():\n"
        f"    return dict(scene={TINY!r}, agents={{'*': {AGENT!r}}}, commandcenter=commandcenter,\n"
        "        evaluator=dict(scorer=dict(type='Scorer')), keyexpr=dict(rewrites=['on_detections.toml']),\n"
        "        adversaries=dict(eve=dict(file='shy_adversary.py', type='Adversary', agent='infra_1',\n"
        "            attack=dict(type='Shy'))))\n"
    )
    resolved_scenario = resolved(write_scenario(tmp_path, text))
    assert not Run(resolved_scenario).failures
    assert type(build_node(resolved_scenario.nodes["eve"], "eve").attack).__name__ == "Shy"


# -- invalid scenarios are refused --------------------------------------------------------------------------------


EVE = dict(agent="ego", attack=dict(type="PassThrough"))
CLUSTERING = "command_center.pipeline.clustering"

#: What is put where in a scenario, and how it is refused, after the name of the file.
INVALID: list[tuple[Any, Any, str]] = [
    ("agent", {}, "agent: unknown key; did you mean 'agents'"),
    (3, {}, "3: unknown key"),
    ("broker", "fast", "broker: found 'fast', expected a dict"),
    ("agents", [1], r"agents: found \[1\], expected a dict"),
    ("scene", "intersecton", r"scene 'intersecton': unknown name .*'intersection'"),
    ("scene", 3, "scene: found 3, expected a short name or a dict"),
    ("scene", dict(type="TinyScen"), r"scene\.type: .*did you mean 'TinyScene'"),
    ("scene", dict(type=[1]), r"scene\.type: no Scene named \[1\]"),
    (
        "scene",
        dict(type="Intersection", n_infrastructure=99),
        "scene: Intersection: n_infrastructure is 99",
    ),
    ("agents", {"infra_*": AGENT}, "agents: no entry for 'ego'"),
    ("agents", {"*": 3}, "agents: ego: found 3, expected a dict"),
    ("broker.patiens", 1, "broker.patiens: .*did you mean 'patience'"),
    ("command_center", {}, "command_center: CommandCenter needs pipeline"),
    ("broker.patience", -1, "broker: Broker: patience: found -1, expected 0 or more"),
    (f"{CLUSTERING}.type", "SampledAssigmentCluster", rf"{CLUSTERING}\.type: .*'SampledAssignmentClusterer'"),
    (f"{CLUSTERING}.7", 1, rf"{CLUSTERING}\.7: SampledAssignmentClusterer has no such parameter"),
    (
        "adversaries.adversary_1.agent",
        "infra_9",
        r"adversaries\..* no agent 'infra_9' .* mean 'infra_[12]'",
    ),
    ("adversaries.adversary_1.agent", None, r"adversaries\.adversary_1\.agent: found none, expected an agent"),
    ("adversaries.eve", "PassThrough", r"adversaries\.eve: found 'PassThrough', expected a dict"),
    ("adversaries", {1: EVE}, "adversaries: found the name 1, expected a string"),
    ("adversaries.ego", EVE, "ego: another node already has this name"),
    ("adversaries.evaluator", EVE, "evaluator: another node already has this name"),
    ("nodes", dict(broker=dict(role="broker")), "broker: another node already has this name"),
    ("nodes", dict(tap=3), "nodes.tap: found 3, expected a dict"),
    ("run.speed", 2, "run.speed: unknown key"),
    ("run.mode", "lock-step", "run.mode: found 'lock-step'; did you mean 'lockstep'"),
    ("run.seed", -1, "run.seed: found -1, expected a whole number from 0"),
    ("run.seed", "x", "run.seed: found 'x'"),
    ("run.frames", 0, "run.frames: found 0, expected a whole number from 1"),
    ("run.rate", 0, "run.rate: found 0, expected a number above 0"),
    ("broker.on_exit", "go on", r"broker\.on_exit: found 'go on'"),
    ("keyexpr.rewrites", "on_tracks.toml", "keyexpr.rewrites: found 'on_tracks.toml', expected a list"),
]
INVALID_NODES: list[tuple[str, Any, str]] = [
    ("broker.file", "brokr.py", r"broker: no node file 'brokr\.py'; did you mean 'broker\.py'"),
    ("broker.file", "agent.py", "broker: Agent in .* has the role 'agent', expected 'broker'"),
    ("broker.type", "Broke", "defines no node 'Broke'; did you mean 'Broker'"),
    ("broker.type", 3, "type is 3, expected the name of a node"),
    ("nodes", dict(x=dict(role="spy")), r"x: no node file 'spy\.py'"),
    ("nodes", dict(x={}), "x: no node file"),
]
INVALID_WIRING: list[tuple[str, Any, str]] = [
    ("keyexpr.map", "testbd.toml", r"testbd\.toml: no such .*did you mean 'testbed\.toml'"),
    ("keyexpr.rewrites", ["on_track.toml"], r"did you mean 'on_tracks\.toml'"),
    ("keyexpr.rewrites", [{"inserts": []}], r"keyexpr\.rewrites\[0\]: unknown key 'inserts'; did you mean 'insert'"),
]


@pytest.mark.parametrize(
    ("kind", "code", "place", "value", "reason"),
    [
        *((ConfigurationError, 10, place, value, rf"uncoordinated\.py: {reason}") for place, value, reason in INVALID),
        *((NodeFileError, 12, *row) for row in INVALID_NODES),
        *((WiringError, 11, *row) for row in INVALID_WIRING),
    ],
)
def test_an_error_in_a_scenario_is_reported_with_its_path(
    kind: type[MastError], code: int, place: Any, value: Any, reason: str
) -> None:
    _, content = load("uncoordinated", ["n_adversaries=1"])
    content["scene"] = dict(TINY)
    *steps, last = place.split(".") if isinstance(place, str) else [place]
    value_at(content, ".".join(steps))[last] = value
    with pytest.raises(MastError, match=reason) as caught:
        resolve(bundle.ROOT / "scenarios" / "uncoordinated.py", content)
    assert (type(caught.value), caught.value.exit_code) == (kind, code)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("def scenario():\n    return 3\n", r"mine\.py: scenario\(\.\.\.\) returned"),
        ("def scenario(n):\n    return {}\n", r"mine\.py: scenario\(\.\.\.\): TypeError: .*'n'"),
        ("def scenario():\n    return {}['x']\n", r"mine\.py.*KeyError: 'x'"),
        (
            "def scenario():\n    return dict(commandcenter={}, command_center={})\n",
            r"r.*command_center.*same",
        ),
        (
            "import mast_zenoh.scenario as s\ndef scenario():\n    return dict(scene=s.choose_scene('av3:x'))\n",
            r"mine\.py.*'av3:x'.*'av3'",
        ),
    ],
)
def test_an_exception_in_the_scenario_function_is_reported_with_its_file(
    tmp_path: Path, text: str, reason: str
) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        load(write_scenario(tmp_path, text))


def test_launch_options_override_the_scenario_file() -> None:
    path, content = load("baseline", ["run.seed=3", "run.mode=realtime"])
    content["scene"] = TINY
    assert (resolve(path, content, frames=2).seed, resolve(path, content, frames=2, seed=5).seed) == (3, 5)
    resolved_scenario = resolve(path, content, frames=2, mode="lockstep", rate=2)
    assert (resolved_scenario.mode, resolved_scenario.rate, resolved_scenario.frames) == ("lockstep", 2.0, 2)
    with pytest.raises(ConfigurationError, match=r"run\.spede: unknown key"):
        resolve(path, content, frames=2, spede=1)


def test_a_scene_takes_the_options_that_are_set() -> None:
    known = dict(scene_index=1, n_infrastructure=3, n_mobile=2)
    choose = scenario.choose_scene
    assert choose("intersection", **known) == dict(type="Intersection", **known)
    assert choose("intersection:1", **known) == choose("intersection", **known)
    nothing = dict.fromkeys(known)
    assert choose("avstack:x", **nothing) == dict(type="AVstackScene", path="x")
    assert choose(dict(type="TinyScene", n_infrastructure=1), **nothing) == dict(type="TinyScene", n_infrastructure=1)


@pytest.mark.parametrize(
    ("scene", "option", "reason"),
    [
        ("avstack:x", dict(scene_index=0), r"scene: AVstackScene.*'scene_index'"),
        (dict(type="TinyScene"), dict(n_mobile=0), "parameter 'n_mobile'; .*n_infrastructure"),
        ("intersection:2", dict(scene_index=1), r"scene: scene_index.*'intersection:2'"),
    ],
)
def test_an_unknown_or_contradictory_scene_option_is_refused(scene: Any, option: Any, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        scenario.choose_scene(scene, **option)


def test_an_agents_name_overrides_a_pattern() -> None:
    def choose(content: dict[str, Any]) -> None:
        content["agents"] = {
            name: AGENT | {"status_every": n} for name, n in (("*", 1), ("infra_*", 2), ("infra_2", 3))
        }

    resolved_scenario = tiny(edit=choose)
    assert [resolved_scenario.nodes[name].config["status_every"] for name in ("ego", "infra_1", "infra_2")] == [1, 2, 3]


def test_pictures_are_scored_for_as_long_as_agents_use_them() -> None:
    def hold(content: dict[str, Any]) -> None:
        content["agents"]["infra_*"] = AGENT | {"picture_age_s": 1.5}

    def hold_longer_than_stated(content: dict[str, Any]) -> None:
        hold(content)
        content["evaluator"] = {**content["evaluator"], "picture_age_s": 0.2}

    configs = [tiny(edit=edit).nodes["evaluator"].config for edit in (None, hold, hold_longer_than_stated)]
    names = ("picture_age_s", "picture_ages_s")
    assert [tuple(config.get(name) for name in names) for config in configs] == [
        (None, None),
        (None, {"infra_1": 1.5, "infra_2": 1.5}),
        (0.2, None),
    ]


def test_an_agent_gets_its_sensor_and_mobility_from_the_scene() -> None:
    resolved_scenario = tiny()
    ego, pole = (build_node(resolved_scenario.nodes[name], name) for name in ("ego", "infra_1"))
    assert (ego.mobile, pole.mobile) == (True, False)
    assert (ego.lidars[0].azimuth_min_deg, pole.lidars[0].azimuth_min_deg) == (-180.0, -45.0)


# -- round trip -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["baseline", "uncoordinated", "coordinated", "passthrough"])
def test_a_resolved_scenario_survives_a_round_trip_and_gives_the_same_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resolved_scenario = tiny(
        name, *(() if name in ("baseline", "passthrough") else ("n_adversaries=1", "attack_start_s=0.2"))
    )
    resolved_scenario.write(tmp_path)
    monkeypatch.chdir(tmp_path)  # like a node's process: the scene is stored there
    back = Resolved.read(tmp_path)
    assert json.loads(json.dumps(back.to_json())) == json.loads(json.dumps(resolved_scenario.to_json()))
    assert Wiring.from_json(back.wiring) == Wiring.from_json(resolved_scenario.wiring)
    first, second = Run(resolved_scenario), Run(back)
    assert first.messages == second.messages
    assert first.packed == second.packed


def test_every_run_builds_new_nodes() -> None:
    resolved_scenario = tiny("passthrough")
    first, second = (build_node(resolved_scenario.nodes["adversary_0"], "adversary_0") for _ in range(2))
    assert first is not second
    assert isinstance(first.attack, PassThrough)
    assert first.attack is not second.attack
    pipelines = [build_node(resolved_scenario.nodes[name], name).pipeline for name in ("infra_1", "infra_2")]
    assert pipelines[0].tracker is not pipelines[1].tracker, "agents with one configuration share no objects"


def test_a_node_that_would_receive_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "judge.py").write_text(
        "from mast_zenoh.node import Node\n\n\nclass Judge(Node):\n    role = 'evaluator'\n"
        "    inputs = {'picture': 'picture'}\n\n    def __init__(self, agents: tuple[str, ...]): ...\n\n"
        "    def on_picture(self, received, context): ...\n"
    )
    file = str(tmp_path / "own.py")
    Path(file).write_text(
        "from mast_zenoh.config import loading\n\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n\n\n"
        "def scenario():\n    return baseline() | dict(name='own', evaluator=dict(file='judge.py'))\n"
    )
    with pytest.raises(WiringError, match=r"evaluator.*nothing.*'\*'"):
        resolved(file)


def test_classes_of_a_scenario_on_which_another_is_based_reach_other_processes(tmp_path: Path) -> None:
    first, second = tmp_path / "first.py", tmp_path / "folder" / "second.py"
    first.write_text(
        "from mast_zenoh.attacks import PassThrough\n"
        "from mast_zenoh.scenario import load\n"
        "class OnlyInTheFirst(PassThrough):\n"
        "    pass\n"
        "def scenario():\n"
        "    _, base = load('uncoordinated', ['n_adversaries=1'])\n"
        "    for adversary in base['adversaries'].values():\n"
        "        adversary['attack'] = dict(type='OnlyInTheFirst')\n"
        "    return base\n"
    )
    second.parent.mkdir()
    second.write_text(
        "from mast_zenoh.scenario import load\n"
        "def scenario():\n"
        f"    return load({str(first)!r})[1] | dict(name='made')\n"
    )
    path, loaded = scenario.load(str(second))
    assert scenario.resolve(path, loaded, frames=1).modules == (str(first),)
    assert scenario.resolve(*scenario.load(str(first)), frames=1).modules == (str(first),)


def test_a_scenario_that_changes_what_it_takes_from_another_one_changes_only_its_own() -> None:
    before = scenario.load("peers")[1]
    scenario.load("peers", ["relays=true"])
    assert scenario.load("peers")[1] == before
