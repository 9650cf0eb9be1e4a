"""Installed packages bring classes; ours win, and a broken plugin stops only what needs it."""

import ast
import importlib
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import mast_datasets
import pytest

from mast_zenoh.config import plugins, registry
from mast_zenoh.mesh.control import failures
from mast_zenoh.scenes import Scene
from mast_zenoh.study import trial

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGE = (DOCS / "how-to-write-a-part.md").read_text(encoding="utf-8")
EXAMPLE = re.compile(r"^```\w+ file=(\S+\.(?:py|toml))\n(.*?)^```$", flags=re.S | re.M)
FILES = {name: text for name, text in EXAMPLE.findall(PAGE) if name in ("pyproject.toml", "mast_roadside.py")}


def installed(site: Path, name: str, code: str) -> Path:
    """A distribution of one module with an entry point, as an installer leaves it."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[mast_zenoh.plugins]\n{name} = {name}\n")
    (site / f"{name}.py").write_text(code)
    return site


def environment(site: Path) -> dict[str, str]:
    """That of a process with the packages of a folder."""
    return os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}", "COLUMNS": "1000"}


def mast(site: Path, *words: str, cwd: Path | None = None) -> str:
    """Everything that a command prints, with the packages of a folder."""
    command, options = [sys.executable, "-m", "mast_zenoh", *words], dict(capture_output=True, text=True, check=False)
    process = subprocess.run(command, env=environment(site), cwd=cwd or apart(site), **options)
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout + process.stderr


#: Runs commands one after the other; prints the exit code of each, and everything that it prints.
COMMANDS = """
import json, sys
sys.path.append(sys.argv.pop())
from commands_in_process import command
ended = [command(*words) for words in json.loads(sys.argv[1])]
print(json.dumps([(each.code, each.out + each.err) for each in ended]))
"""


def mast_each(site: Path, *commands: str) -> list[tuple[int, str]]:
    """The exit code and everything that is printed of several commands in one process."""
    words = json.dumps([command.split() for command in commands])
    process = subprocess.run(
        [sys.executable, "-c", COMMANDS, words, str(ROOT / "tests" / "support")],
        env=environment(site),
        cwd=apart(site),
        capture_output=True,
        text=True,
        check=True,
    )
    return [(code, printed) for code, printed in json.loads(process.stdout.splitlines()[-1])]


def apart(site: Path) -> Path:
    """A working directory: plugins in that are ignored."""
    folder = site / "elsewhere"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="module")
def roadside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plugin of the page, installed with pip into a folder of its own."""
    source, site = tmp_path_factory.mktemp("mast-roadside"), tmp_path_factory.mktemp("site")
    for name, text in FILES.items():
        (source / name).write_text(text)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(site)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(source)], check=True, capture_output=True)
    return site


RUN = (
    *("run", "uncoordinated", "--frames", "20", "--no-report", "--set", "scene=convoy:5", "--set", "n_adversaries=1"),
    *(
        "--set",
        "adversaries.adversary_1.attack={'type': 'Nudge'}",
        "--set",
        "evaluator.metrics=[{'type': 'QuietShare'}]",
    ),
)


@pytest.mark.parametrize("runtime", ["inproc", pytest.param("mesh", marks=[pytest.mark.heavy, pytest.mark.mesh])])
def test_a_plugin_installed_with_pip_brings_a_scene_an_attack_and_a_metric(
    roadside: Path, tmp_path: Path, runtime: str
) -> None:
    mast(roadside, *RUN, "--runtime", runtime, "--out", str(tmp_path / "run"))
    scenario = json.loads((tmp_path / "run" / "scenario.json").read_text())
    assert scenario["plugins"] == dict.fromkeys(("Convoy", "Nudge", "QuietShare"), "mast-roadside 1.0")
    assert not scenario["modules"], "plugins are found by name, not as files of the user"
    assert json.loads((tmp_path / "run" / "run.json").read_text())["versions"]["mast-roadside"].startswith(
        "1.0 (sources "
    )
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert "quiet_share" in metrics["agents"]["ego"]["picture"]
    listed = " ".join(mast(roadside, "list", "scenes", "Convoy").split())
    assert "Cars in a row pass two poles at 10 m/s; convoy:N_CARS (plugin mast-roadside 1.0)" in listed


RUN_BASELINE = "run baseline --frames 3 --runtime inproc --no-report"
RULE = """
from mast_zenoh.links import Rule


class Tunnel(Rule):
    fate = "dropped"

    def apply(self, passage, row):
        return ()
"""


def test_a_rule_of_a_plugin_can_be_a_fault(tmp_path: Path) -> None:
    site = installed(tmp_path / "site", "tunnels", RULE)
    fault = '[{"type": "Impair", "rule": {"type": "Tunnel"}, "on": "infra_1", "at": 0.2, "until": 0.5}]'
    words = ("--frames", "8", "--no-report", "--set", f"faults={fault}", "--runtime", "inproc")
    mast(site, "run", "baseline", *words, "--out", str(tmp_path / "run"))
    scenario = json.loads((tmp_path / "run" / "scenario.json").read_text())
    assert scenario["plugins"] == {"Tunnel": "tunnels 1.0"}
    link = json.loads((tmp_path / "run" / "metrics.json").read_text())["interposers"]["link_infra_1"]
    assert link["effects"]["dropped"] >= 3


def test_a_changed_plugin_makes_other_trials_and_its_lines_are_named_in_failures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site-packages"
    module = installed(site, "edited", "def step():\n    raise ValueError(1)\n") / "edited.py"
    monkeypatch.syspath_prepend(site)
    monkeypatch.setattr(plugins, "installed", lambda: (plugins.Plugin("edited", "edited", "edited 1.0"),))
    step = importlib.import_module("edited").step
    with pytest.raises(ValueError, match="1") as raised:
        step()
    assert failures.location(raised.value, step) == f"{module}:2"
    before = trial.environment(["edited 1.0"])
    module.write_text("def step(): ...\n")
    plugins._digest.cache_clear()
    after = trial.environment(["edited 1.0"])
    assert {name for name in before if before[name] != after[name]} == {"edited"}
    assert trial.environment([]).keys() == before.keys() - {"edited"}


def test_a_plugin_in_the_working_directory_is_not_run(tmp_path: Path) -> None:
    site = installed(tmp_path, "received", "from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n")
    mast(site, "list", "scenes", cwd=site)
    assert not (site / "received.ran").exists()
    mast(site, "list", "scenes")
    assert (site / "received.ran").exists(), "elsewhere it is a plugin"


def test_an_entry_point_that_names_no_module_of_its_own_stops_nothing_else(tmp_path: Path) -> None:
    for name, module in (("odd", "dashed-name"), ("ours", "mast_zenoh.nothing")):
        site = installed(tmp_path, name, "")
        points = site / f"{name}-1.0.dist-info" / "entry_points.txt"
        points.write_text(f"[mast_zenoh.plugins]\n{name} = {module}\n")
    (listing, listed), (run, _) = mast_each(site, "list scenes", RUN_BASELINE)
    assert "odd 1.0 cannot be imported: ModuleNotFoundError: No module named 'dashed-name'" in listed
    assert "ours 1.0 is left out: its module is mast_zenoh.nothing, expected one outside mast_zenoh" in listed
    assert "Intersection" in listed
    assert (listing, run) == (0, 0)


SCENE = """from mast_zenoh.scenes import Scene
class {name}(Scene):
    "A road."
    short_name, short_argument = "{short}", "{argument}"
    def __init__(self, *, n_cars: int = 4) -> None: ...
    def record(self, seed, frames): ...
"""
NAMESAKE = "from mast_zenoh.attacks import Attack\nclass {name}(Attack):\n    def step(self, *arguments): ...\n"


def test_a_broken_plugin_is_warned_about_once_and_stops_only_what_may_need_it(tmp_path: Path) -> None:
    site = installed(tmp_path, "broken", "import nowhere\n")
    cause = "the plugin broken of broken 1.0 cannot be imported: ModuleNotFoundError: No module named 'nowhere'"
    needed = ("list scenes RingRoad", "list attacks Extra", "scene check ringroad:4")
    commands = (RUN_BASELINE, "list scenes", f"{RUN_BASELINE} --set scene.type=Elsewhere", *needed)
    (_, run), (_, listed), *refused = mast_each(site, *commands)
    assert listed.count(cause) == 1
    assert "AV2Log" in listed, "other plugins work"
    assert "cannot be imported" not in run
    assert [code for code, _ in refused] == [35] * 4
    assert all("broken 1.0 cannot be imported" in printed for _, printed in refused)


def test_a_plugin_whose_import_does_not_end_is_named_with_how_to_leave_it_out(tmp_path: Path) -> None:
    site = installed(tmp_path, "hanging", "import threading\nthreading.Event().wait()\n")
    command = [sys.executable, "-m", "mast_zenoh", "list"]
    environment = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    with subprocess.Popen(command, env=environment, cwd=apart(site), stderr=subprocess.PIPE, text=True) as process:
        guard = threading.Timer(120.0, process.kill)
        guard.start()
        line = process.stderr.readline()
        guard.cancel()
        process.kill()
    assert "hanging of hanging" in line
    assert "pip uninstall hanging" in line


def test_a_plugin_that_takes_a_name_is_left_out(tmp_path: Path) -> None:
    site = installed(tmp_path, "like_ours", NAMESAKE.format(name="CoordinatedAttack"))
    for name in ("one", "other"):
        installed(tmp_path, name, NAMESAKE.format(name="Twice"))
    installed(tmp_path, "a_log", SCENE.format(name="AV2Log", short="logs", argument="n_cars"))
    installed(tmp_path, "junctions", SCENE.format(name="Junctions", short="intersection", argument="n_cars"))
    (_, listed), checked = mast_each(site, "list attacks", "scene check nowhere.tar.gz")
    for name, reason in (
        ("like_ours", "its class CoordinatedAttack has the name of mast_zenoh.attacks.attack.CoordinatedAttack"),
        ("other", "its class Twice has the name of one.Twice"),
        ("a_log", "its class AV2Log has the name of mast_datasets.argoverse.AV2Log"),
        ("junctions", "its class Junctions has the short name 'intersection' of mast_zenoh.scenes.generated."),
    ):
        assert f"{name} 1.0 is left out: {reason}" in listed
    assert listed.count("is left out") == 4
    assert listed.count("\nTwice\n") == listed.count("\nCoordinatedAttack\n") == 1
    assert (checked[0], "nowhere.tar.gz" in checked[1]) == (10, True)


def test_short_names_of_a_plugin_are_shown_and_its_faults_named(tmp_path: Path) -> None:
    site = installed(tmp_path, "rings", SCENE.format(name="RingRoad", short="ringroad", argument="n_cars"))
    installed(tmp_path, "wrong", SCENE.format(name="WrongRoad", short="wrong", argument="cars"))
    (tmp_path / "unknown").mkdir()
    expected = {
        "list scenes RingRoad": (0, "A road; ringroad:N_CARS (plugin rings 1.0)"),
        "doctor": (0, "rings 1.0"),
        "scene check ringroad:ten": (10, "'ten' is not a whole number, expected ringroad:N_CARS, 0 or more"),
        "scene check wrong:4": (
            10,
            "wrong.WrongRoad.short_argument is 'cars', expected one of its parameters; did you",
        ),
        f"scene check {tmp_path / 'unknown'}": (13, "expected the files of one of recording, av2,"),
        "run baseline --set scene=carla:x": (
            *(10, "unknown name 'carla', expected one of NAME:PATH, intersection:SCENE_INDEX, ringroad:N_CARS, road:"),
        ),
    }
    for (words, (code, reason)), ended in zip(expected.items(), mast_each(site, *expected), strict=True):
        assert (ended[0], reason in ended[1]) == (code, True), ended[1]
        assert not words.startswith("scene") or not re.search(r"one of .*(intersection|ringroad)", ended[1])


def test_a_missing_plugin_is_named() -> None:
    code = (
        "from pathlib import Path\nfrom mast_zenoh.config import plugins, registry\n"
        "from mast_zenoh.deploy import engines\nfrom mast_zenoh.errors import PluginError\n"
        "from mast_zenoh.scenario import resolve\n"
        "from mast_zenoh.scenes import Scene\nfrom importlib import metadata\n"
        "metadata.distributions = lambda path: []\n"
        "plugins.expect({'Nudge': 'mast-roadside 1.0', 'Gentle': 'mast-ringroad 0.4'})\n"
        "for build in (lambda: registry.parse_scene('av2:PATH'),\n"
        "              lambda: registry.build({'type': 'AV2Log', 'path': 'x'}, Scene, 'scene'),\n"
        "              lambda: registry.build({'type': 'Nudge'}, Scene, 'attack'),\n"
        "              lambda: engines.load('Gentle'),\n"
        "              lambda: resolve(Path('x.py'), {'ros2': {}}),\n"
        "              lambda: resolve(Path('x.py'), {'broker': {'file': 'ros2_agent.py'}}, frames=1)):\n"
        "    try: build()\n    except PluginError as error: print(error)\n"
        "plugins._SOURCES /= 'elsewhere'\nprint(*map(plugins.command_for, plugins.OUR_PLUGINS), sep=', ')\n"
    )
    lines = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    sources = ROOT / "plugins" / "datasets"
    needs = f"reading Argoverse 2 needs the plugin mast-zenoh-datasets, expected: pip install -e {sources}"
    first, second, third, fourth, part, node, released = lines.splitlines()
    assert first == f"scene 'av2:PATH': {needs}"
    assert f"named 'AV2Log': {needs}" in second
    assert third.endswith("install it here")
    assert fourth.startswith("there is no")
    needs = f"ROS 2 needs the plugin mast-zenoh-ros2, expected: pip install -e {sources.parent / 'ros2'}"
    assert f"unknown key: {needs}" in part
    assert f"file 'ros2_agent.py': {needs}" in node
    assert "pip install 'mast-zenoh[ros2]'" in released


def test_the_errors_know_all_data_sets() -> None:
    assert set(plugins.DATA_SETS) == set(mast_datasets.__all__)
    known = {short: cls.__name__ for short, cls in registry.short_names().items() if plugins.plugin_of(cls)}
    assert known == registry._DATA_SETS


def test_plugins_are_imported_for_unknown_names_only() -> None:
    code = (
        "import sys, mast_zenoh\nfrom mast_zenoh import scenario\nfrom mast_zenoh.config import registry\n"
        "scenario.resolve(*scenario.load('coordinated'), frames=2)\nprint('mast_datasets' in sys.modules)\n"
        "registry.parse_scene('av2:x')\nprint('mast_datasets' in sys.modules)\n"
    )
    printed = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["False", "True"]


def test_a_plugin_does_not_change_the_default_of_a_part_with_one_class() -> None:
    class Part:
        pass

    class OfPlugin(Part):
        pass

    OfPlugin.__module__ = "mast_datasets.parts"
    assert type(registry.build({}, Part, "part")) is Part
    assert plugins.plugin_of(OfPlugin) is not None
    assert plugins.plugin_of(Scene) is None


def test_the_plugin_for_data_sets_the_tutorials_and_all_pages_use_public_names_only() -> None:
    rows = re.findall(r"^\| `(mast_zenoh[\w.]*)` \| (.*) \|$", PAGE, flags=re.M)
    public = {f"{module}.{name}" for module, names in rows for name in re.findall(r"`(\w+)`", names)}
    bases = (DOCS / "ref-python.md").read_text().partition("## Base classes")[2]
    public |= set(re.findall(r"`(mast_zenoh\.[\w.]+)`", bases))
    sources = {path.name: path.read_text() for path in Path(mast_datasets.__file__ or "").parent.glob("*.py")}
    for page in DOCS.glob("*.md"):
        blocks = re.findall(r"^```python\b.*?\n(.*?)^```$", page.read_text(), flags=re.S | re.M)
        sources |= {f"{page.name}, block {number}": code for number, code in enumerate(blocks, 1)}
    sources |= {f"docs/examples/{path.name}": path.read_text() for path in (DOCS / "examples").glob("*.py")}
    named = {*("AdaptiveAttack", "Lies", "Moment", "FollowingEgo", "FalseTraffic"), "alter"}
    assert public >= {f"mast_zenoh.attacks.{name}" for name in named}
    assert public >= {"mast_zenoh.integrity.sightings", "mast_zenoh.integrity.ClusterBoxes", "mast_zenoh.scenario.load"}
    for place in sorted(public):
        module, _, name = place.rpartition(".")
        assert hasattr(importlib.import_module(module), name), place
    public |= {module for module, _ in rows}  # `from mast_zenoh import scenario`
    others = []
    for file, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            names = [f"{node.module}.{each.name}" for each in node.names] if isinstance(node, ast.ImportFrom) else []
            names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            others += [f"{file}: {name}" for name in names if name.startswith("mast_zenoh.") and name not in public]
    assert not others
