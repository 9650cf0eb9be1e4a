"""Run folders as an attacker would send them: each case changes a copy of a sound run."""

import json
import os
import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

#: A command by name: its words, with RUN (the hostile folder), SOUND (a sound run of the same scenario) and OUT.
COMMANDS: dict[str, tuple[str, ...]] = {
    "report": ("report", "RUN"),
    "report measured": ("report", "RUN", "--measure"),
    "report against twin": ("report", "RUN", "--against", "twin"),
    "report against it": ("report", "SOUND", "--against", "RUN"),
    "diff": ("diff", "RUN", "SOUND"),
    "logs": ("logs", "RUN"),
    "export": ("export", "RUN", "--to", "mot", "--out", "OUT"),
    "export kitti": ("export", "RUN", "--to", "kitti", "--out", "OUT"),
    "export csv": ("export", "RUN", "--to", "csv", "--out", "OUT"),
    "export pcap": ("export", "RUN", "--to", "pcap", "--out", "OUT"),
    "animate": ("animate", "RUN", "--out", "OUT.gif", "--size", "320x200", "--to", "0"),
    "snapshot": ("snapshot", "RUN", "--out", "OUT.png", "--size", "320x200"),
    "replay": ("replay", "RUN", "--runtime", "inproc", "--no-report", "--out", "OUT"),
    "view": ("view", "RUN"),
    "view both": ("view", "SOUND", "RUN"),
    "intercept": ("intercept", "RUN", "--wire", "agent/infra_1/tracks", "--with", "adversary"),
    "release": ("release", "RUN", "--name", "adversary_1"),
    "deploy status": ("deploy", "status", "RUN"),
    "deploy logs": ("deploy", "logs", "RUN"),
    "deploy down": ("deploy", "down", "RUN"),
}


class Place(NamedTuple):
    """Where a case is built.

    folder:  the run folder to spoil
    outside: a folder that the victim owns, in which nothing may change
    marker:  a file there; code that runs creates it
    """

    folder: Path
    outside: Path

    @property
    def marker(self) -> Path:
        return self.outside / "code_ran"

    @property
    def code(self) -> str:
        """Python that leaves the marker, and defines what could be asked for."""
        return f"open({str(self.marker)!r}, 'w').close()\n{_DEFINITIONS}"


_DEFINITIONS = """
from mast_zenoh.evaluation.evaluation import *
from mast_zenoh.node import Node
class Evaluator(Node): pass
"""

Case = Callable[[Place], None]
CASES: dict[str, Case] = {}


def case(function: Case) -> Case:
    """Add a case by its function's name."""
    CASES[function.__name__] = function
    return function


def _named(name: str, spoil: Case) -> None:
    CASES[name] = spoil


def edit(place: Place, file: str, change: Callable[[Any], Any]) -> None:
    """Change the content of a JSON file of the folder."""
    path = place.folder / file
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def set_in(place: Place, file: str, keys: str, value: Any) -> None:
    """Set a key of a JSON file, given as a path."""

    def change(inner: Any) -> None:
        *parents, last = (int(key) if key.isdigit() else key for key in keys.split("/"))
        for key in parents:
            inner = inner[key]
        inner[last] = value

    edit(place, file, change)


def lacks_metrics(place: Place) -> None:
    """A report measures a run without metrics."""
    (place.folder / "metrics.json").unlink()


# -- code --------------------------------------------------------------------------------------------------------------


def _code_at(place: Place, where: str) -> str:
    """Write code into a file; returns the name under which a scenario names it."""
    path = {
        "inside": place.folder / "evil.py",
        "outside": place.outside.parent / "evil.py",
        "deep": place.folder / "results" / "evil.py",
    }[where]
    path.write_text(place.code)
    return str(path)


def _code_named_by(keys: str, where: str, *, listed: bool = False) -> Case:
    def spoil(place: Place) -> None:
        name = _code_at(place, where)
        set_in(place, "scenario.json", keys, [name] if listed else name)
        lacks_metrics(place)

    return spoil


for _where in ("inside", "outside", "deep"):
    _named(f"module_{_where}", _code_named_by("modules", _where, listed=True))
for _node in ("evaluator", "command_center", "broker", "simulator", "ego", "adversary_1", "recorder"):
    _named(f"file_of_{_node}", _code_named_by(f"nodes/{_node}/file", "inside"))
_named("file_of_evaluator_outside", _code_named_by("nodes/evaluator/file", "outside"))


@case
def relative_files(place: Place) -> None:
    (place.folder / "evil.py").write_text(place.code)
    set_in(place, "scenario.json", "modules", ["evil.py", "../run/evil.py"])
    set_in(place, "scenario.json", "nodes/evaluator/file", "evil.py")
    lacks_metrics(place)


@case
def node_files_beside_the_scenario(place: Place) -> None:
    for name in ("evaluator", "command_center", "broker", "agent", "adversary", "simulator"):
        (place.folder / f"{name}.py").write_text(place.code)

    def elsewhere(scenario: Any) -> None:
        for node in scenario["nodes"].values():
            node["file"] = f"/elsewhere/{Path(node['file']).name}"

    edit(place, "scenario.json", elsewhere)
    lacks_metrics(place)


@case
def a_folder_called_nodes(place: Place) -> None:
    (place.folder / "nodes").mkdir()
    (place.folder / "nodes" / "evaluator.py").write_text(place.code)
    set_in(place, "scenario.json", "nodes/evaluator/file", str(place.folder / "nodes" / "evaluator.py"))
    lacks_metrics(place)


@case
def a_folder_called_as_the_package(place: Place) -> None:
    file = place.folder / "mast_zenoh" / "runtime" / "player.py"
    file.parent.mkdir(parents=True)
    file.write_text(place.code)
    set_in(place, "scenario.json", "nodes/command_center/file", str(file))
    lacks_metrics(place)


@case
def modules_that_python_would_find(place: Place) -> None:
    for name in ("numpy", "sitecustomize", "conftest", "evaluator", "matplotlib"):
        (place.folder / f"{name}.py").write_text(place.code)


@case
def dotted_types(place: Place) -> None:
    set_in(place, "scenario.json", "nodes/evaluator/type", "os.system")
    set_in(place, "scenario.json", "nodes/command_center/config/pipeline", {"type": f"os.mkdir:{place.marker}"})
    lacks_metrics(place)


@case
def files_as_types(place: Place) -> None:
    name = _code_at(place, "inside")
    set_in(place, "scenario.json", "nodes/command_center/config/pipeline", {"type": f"{name}:Evil"})
    set_in(place, "scenario.json", "nodes/evaluator/config/scorer", {"type": name})
    set_in(place, "scenario.json", "scene", {"type": f"{name}:Evil"})
    lacks_metrics(place)


@case
def figures_metrics_and_checks_of_a_user(place: Place) -> None:
    name = _code_at(place, "inside")

    def name_code(scenario: Any) -> None:
        for key in ("modules", "figures", "metrics", "checks", "plugins", "entry_points"):
            scenario[key] = [name]

    edit(place, "scenario.json", name_code)
    (place.folder / "figures").mkdir(exist_ok=True)
    (place.folder / "figures" / "user_figures.json").write_text(json.dumps([{"name": "evil", "file": name}]))


@case
def engine_of_a_user(place: Place) -> None:
    set_in(place, "run.json", "deployment", {"engine": _code_at(place, "inside"), "label": "x"})


@case
def engine_of_a_user_by_class(place: Place) -> None:
    set_in(place, "run.json", "deployment", {"engine": f"{_code_at(place, 'inside')}:Evil", "label": "x"})


@case
def host_that_runs_a_command(place: Place) -> None:
    reach = {"name": "evil", "address": "203.0.113.1", "python": f"touch {place.marker};"}
    hosts = {"evil": {"reach": reach, "nodes": ["ego"], "run_folder": "/"}}
    set_in(place, "run.json", "deployment", {"engine": "ssh", "hosts": hosts})


@case
def pickles_in_the_scene(place: Place) -> None:
    import numpy as np

    class Evil:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(place.marker),)

    with (place.folder / "scene.npz").open("wb") as file:
        np.savez(file, allow_pickle=True, head=np.array([Evil()], dtype=object))


@case
def pickle_in_a_table(place: Place) -> None:
    import pyarrow
    from pyarrow import parquet

    metadata = {b"ARROW:extension:name": b"arrow.py_extension_type", b"ARROW:extension:metadata": _pickle(place)}
    field = pyarrow.field("frame", pyarrow.int64(), metadata=metadata)
    table = pyarrow.table([pyarrow.array([0])], schema=pyarrow.schema([field]))
    for name in ("metrics", "objects", "attacks"):
        parquet.write_table(table, place.folder / f"{name}.parquet")


def _pickle(place: Place) -> bytes:
    return f"cos\nmkdir\n(S'{place.marker}'\ntR.".encode()


@case
def running_elsewhere(place: Place) -> None:
    """It names a router, credentials and a process, and code for the viewer."""

    def running(record: Any) -> None:
        record |= {"status": "running", "runtime": "mesh", "endpoint": "tcp/203.0.113.1:7447", "security": "mtls"}
        record["viewer_credentials"] = str(place.outside / "mast-keys-1" / "viewer")
        record["launcher"] = {"machine": "elsewhere", "pid": os.getpid()}

    edit(place, "run.json", running)
    (place.folder / ".intercept").write_bytes(b"secret")
    set_in(place, "scenario.json", "modules", [_code_at(place, "inside")])


@case
def running_here(place: Place) -> None:
    """A launcher on this machine, before it was started again: a process of the victim."""

    def running(record: Any) -> None:
        record |= {"status": "running", "runtime": "mesh", "endpoint": "tcp/203.0.113.1:7447"}
        record["launcher"] |= {"pid": os.getpid(), "boot": "", "began": "1"}

    edit(place, "run.json", running)
    set_in(place, "scenario.json", "modules", [_code_at(place, "inside")])


# -- links -------------------------------------------------------------------------------------------------------------


def _link(name: str, *, folder: bool = False) -> Case:
    def spoil(place: Place) -> None:
        path = place.folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(place.outside / ("folder" if folder else "precious"))

    return spoil


for _file in (
    *("report.html", "run.json", "scenario.json", "wiring.json", "metrics.json", "checks.json"),
    *("metrics.parquet", "objects.parquet", "attacks.parquet", "scene.npz", "messages.mcap", "targets.parquet"),
    "figures/birdseye.png",
    "figures/counts.png",
    "figures/user_figures.json",
    "logs/ego.log",
):
    _named(f"link_{_file.replace('/', '_').replace('.', '_')}", _link(_file))
for _folder in ("figures", "logs", "results", "results/ego", "twin", "scripts"):
    _named(f"linked_folder_{_folder.replace('/', '_')}", _link(_folder, folder=True))


@case
def results_to_be_measured_through_links(place: Place) -> None:
    lacks_metrics(place)
    for name in ("metrics.json", "metrics.parquet", "objects.parquet", "attacks.parquet", "driving.parquet"):
        (place.folder / name).unlink(missing_ok=True)
        (place.folder / name).symlink_to(place.outside / "precious" if name != "metrics.json" else place.marker)


# -- names -------------------------------------------------------------------------------------------------------------

_ESCAPE = "../../outside/escaped"


@case
def name_of_the_run(place: Place) -> None:
    set_in(place, "run.json", "name", _ESCAPE)
    set_in(place, "run.json", "id", _ESCAPE)


def _renamed(name: str, *, absolute: bool = False) -> Case:
    def spoil(place: Place) -> None:
        new = str(place.outside / "escaped") if absolute else _ESCAPE
        for file in ("scenario.json", "wiring.json", "run.json", "metrics.json"):
            path = place.folder / file
            path.write_text(path.read_text().replace(f'"{name}"', json.dumps(new)))

    return spoil


for _name in ("ego", "infra_1", "command_center", "adversary_1", "evaluator"):
    _named(f"name_of_{_name}", _renamed(_name))
_named("absolute_name_of_ego", _renamed("ego", absolute=True))


@case
def names_in_the_recording(place: Place) -> None:
    """Of agents, in metadata of the recording: the wiring there decides which series are exported."""
    path = place.folder / "messages.mcap"
    content = path.read_bytes()
    # Of the same length, so that the lengths of all records stay right.
    path.write_bytes(content.replace(b'"infra_1"', b'"../out/"').replace(b"infra_1/", b"../out//"))


@case
def recording_of_a_replay_elsewhere(place: Place) -> None:
    set_in(place, "scenario.json", "nodes/recorder/config/log", str(place.outside / "escaped.mcap"))


@case
def logs_with_controls_in_their_names(place: Place) -> None:
    (place.folder / "logs" / "\x1b]0;evil\x07.log").write_text("line\n")
    (place.folder / "logs" / "$(touch evil).log").write_text("line\n")


# -- content -----------------------------------------------------------------------------------------------------------

JSON_FILES = ("run.json", "scenario.json", "wiring.json", "metrics.json", "checks.json")


def _content(file: str, content: str | bytes) -> Case:
    def spoil(place: Place) -> None:
        data = content if isinstance(content, bytes) else content.encode()
        (place.folder / file).write_bytes(data)

    return spoil


_DEEP = "[" * 1_000_000
for _file in JSON_FILES:
    _stem = _file.removesuffix(".json")
    _named(f"deep_{_stem}", _content(_file, _DEEP + "]" * 1_000_000))
    _named(f"deep_objects_{_stem}", _content(_file, '{"nodes":' * 200_000 + "1" + "}" * 200_000))
    _named(f"list_as_{_stem}", _content(_file, "[]"))
    _named(f"empty_{_stem}", _content(_file, b""))
    _named(f"nothing_in_{_stem}", _content(_file, "{}"))
_named("run_of_bytes", _content("run.json", b"\xff\xfe\x00"))
_named("wide_metrics", _content("metrics.json", "[" + "[]," * 3_000_000 + "[]]"))
_named("wide_run", _content("run.json", '{"nodes": [' + "{}," * 3_000_000 + "{}]}"))
_named("large_number", _content("run.json", '{"frames": 1' + "0" * 5_000 + "}"))
_named("infinite", _content("run.json", '{"frames": Infinity, "seed": NaN, "status": "ok"}'))
_named("surrogates", _content("run.json", '{"name": "\\ud800", "id": "\\udfff", "status": "ok\\u001b[2J"}'))


@case
def sparse_scenario(place: Place) -> None:
    with (place.folder / "scenario.json").open("wb") as file:
        file.truncate(20 << 30)


_WRONG: tuple[Any, ...] = (7, "text", [1], {"a": 1}, True, 10**30)
_FIELDS: dict[str, tuple[str, ...]] = {
    "run.json": (
        *("id", "name", "status", "message", "runtime", "mode", "seed", "frames", "rate", "started", "command"),
        *("launcher", "launcher/pid", "versions", "timings", "nodes", "nodes/ego", "nodes/ego/role", "churn"),
        *("nodes/ego/last_frame", "nodes/ego/failures", "nodes/ego/rejected", "recording", "recorded", "notices"),
        *("innovations", "replay", "deployment", "endpoint", "security"),
    ),
    "scenario.json": (
        *("name", "seed", "mode", "rate", "frames", "period_ns", "leeway_ns", "scene", "modules", "timeline"),
        *("network", "steps", "nodes", "nodes/ego", "nodes/evaluator/config", "nodes/evaluator/file", "messages"),
        *("nodes/command_center/config/pipeline", "nodes/evaluator/config/scorer", "nodes/ego/role"),
    ),
    "wiring.json": ("wires", "overhearers", "wires/0", "wires/0/legs", "wires/0/key", "wires/0/legs/0/to"),
    "metrics.json": (
        *("frames", "scored_frames", "agents", "agents/ego", "agents/ego/picture", "same_as", "achieved"),
        *("latency_ms", "interposers", "driving", "driven", "consistency", "agents/ego/picture/fn", "late", "settled"),
    ),
}


def _setting(file: str, keys: str, value: Any) -> Case:
    return lambda place: set_in(place, file, keys, value)


_named("name_of_the_scenario", _setting("scenario.json", "name", _ESCAPE))
_RECORDER, _SIMULATOR = "nodes/recorder/config/log", "nodes/simulator/config/recording"
_named("recording_of_a_replay_above", _setting("scenario.json", _RECORDER, "../outside/escaped.mcap"))
_named("scene_of_a_device", _setting("scenario.json", _SIMULATOR, "/dev/zero"))


def wrong_types() -> Iterator[tuple[str, Case]]:
    """A case for each field of each file, with one wrong value, and for values in turn."""
    number = 0
    for file, fields in _FIELDS.items():
        for keys in fields:
            value = _WRONG[number % len(_WRONG)]
            number += 1
            name = f"{file.removesuffix('.json')}_{keys.replace('/', '_')}_{number % len(_WRONG)}"
            yield name, _setting(file, keys, value)


# -- special files -----------------------------------------------------------------------------------------------------

_ALL_FILES = (*JSON_FILES, "messages.mcap", "scene.npz", "metrics.parquet", "objects.parquet", "attacks.parquet")


def _bind(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # the path of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.chdir(here)


def _replaced(file: str, make: Callable[[Path], object]) -> Case:
    def spoil(place: Place) -> None:
        (place.folder / file).unlink(missing_ok=True)
        make(place.folder / file)

    return spoil


_OUTPUTS = ("report.html", "logs/ego.log")
_SOME = ("run.json", "metrics.json", "messages.mcap", "scene.npz", "metrics.parquet")
for _kind, _make, _files in (
    ("pipe", os.mkfifo, (*_ALL_FILES, *_OUTPUTS, "targets.parquet", "trust.parquet", "figures/birdseye.png")),
    ("folder", Path.mkdir, (*_ALL_FILES, *_OUTPUTS)),
    ("device", lambda path: path.symlink_to("/dev/zero"), _SOME),
    ("socket", _bind, _SOME),
):
    for _file in _files:
        _named(f"{_kind}_as_{_file.replace('/', '_').replace('.', '_')}", _replaced(_file, _make))
for _file in ("messages.mcap", "scene.npz", "metrics.parquet", "objects.parquet", "attacks.parquet"):
    _named(f"text_as_{_file.replace('.', '_')}", _content(_file, "text" * 100))


def _text_as_folder(name: str) -> Case:
    def spoil(place: Place) -> None:
        shutil.rmtree(place.folder / name)
        (place.folder / name).write_text("text")

    return spoil


for _folder in ("logs", "figures"):
    _named(f"{_folder}_as_a_file", _text_as_folder(_folder))
