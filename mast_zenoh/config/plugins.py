"""Installed plugins: Python packages whose classes can be named like ours.

A distribution lists modules under the entry points of GROUP. Importing such a module defines its classes: scenes,
attacks, trackers and so on. Plugins are imported for the first name that no loaded class has and for listings, never
before. One that cannot be imported, or takes a name of ours or of a plugin before it, is warned about once and left
out; a name that may be that of its class is a PluginError.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import logging
import sys
import threading
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh.errors import ConfigurationError, MastError, PluginError, nearest

GROUP = "mast_zenoh.plugins"
_OURS = "mast_zenoh"
#: The distributions of our own plugins.
DATA_SETS_PLUGIN, ROS2_PLUGIN = OUR_PLUGINS = "mast-zenoh-datasets", "mast-zenoh-ros2"
#: Names that scenarios use of our plugin for ROS 2: a part, and files of nodes.
_OF_ROS2 = ("ros2", "ros2_agent.py", "ros2_command_center.py", "ros2_adversary.py")
#: Where the sources of our plugins are in a checkout.
_SOURCES = Path(__file__).resolve().parents[2] / "plugins"
_log = logging.getLogger("mast.plugins")

#: How long the import of a plugin may take before it is named, s.
_SLOW_S = 5
_SLOW = (
    "the plugin %s of %s has been importing for %d s, and is waited for; to leave it out, interrupt and uninstall it: "
    "pip uninstall %s"
)


class Plugin(NamedTuple):
    """An entry point of an installed distribution.

    module: to import;  distribution: its name and version, such as "mast-zenoh-datasets 0.1.0"
    """

    name: str
    module: str
    distribution: str

    @property
    def package(self) -> str:
        """The package to which its classes belong."""
        return _package(self.module)

    @property
    def project(self) -> str:
        """The name of its distribution."""
        return self.distribution.partition(" ")[0]


class Loaded(NamedTuple):
    """All plugins after their import: the usable ones, and by plugin why the others are left out."""

    plugins: tuple[Plugin, ...]
    problems: Mapping[Plugin, str]


@cache
def installed() -> tuple[Plugin, ...]:
    """All installed plugins without importing them: ours, then the others by name.

    Not those in the working directory, which may be a run folder of somebody else's.
    """
    from importlib.metadata import distributions  # slow, and most commands need no plugins

    places = [place for place in sys.path if Path(place).resolve() != Path.cwd()]
    plugins: dict[tuple[str, str], Plugin] = {}
    for distribution in distributions(path=places):
        for point in distribution.entry_points.select(group=GROUP):
            module = point.value.partition(":")[0].strip()
            plugin = Plugin(point.name, module, f"{distribution.name} {distribution.version}")
            plugins.setdefault((distribution.name, point.name), plugin)  # the first on the path counts
    return tuple(sorted(plugins.values(), key=lambda plugin: (plugin.project not in OUR_PLUGINS, plugin)))


@cache
def load() -> Loaded:
    """Import all plugins, once."""
    problems: dict[Plugin, str] = {}
    for plugin in installed():
        if plugin.package == _OURS:
            problems[plugin] = f"is left out: its module is {plugin.module}, expected one outside {_OURS}"
            continue
        slow = threading.Timer(
            _SLOW_S, _log.warning, (_SLOW, plugin.name, plugin.distribution, _SLOW_S, plugin.project)
        )
        slow.daemon = True
        slow.start()
        try:
            importlib.import_module(plugin.module)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a plugin may also exit
            text = "".join(filter(str.isprintable, " ".join(str(error).split())))
            problems[plugin] = f"cannot be imported: {type(error).__name__}: {text}"
        finally:
            slow.cancel()
            slow.join()  # a process that forks nodes has no other threads
    packages = {_OURS}
    for plugin in installed():
        if plugin in problems:
            continue
        clashes = (_clash(cls, {*packages, plugin.package}) for cls in _classes_of(plugin))
        if clash := next(filter(None, clashes), ""):
            problems[plugin] = f"is left out: {clash}, expected different names"
        else:
            packages.add(plugin.package)
    for plugin, problem in problems.items():
        _log.warning("the plugin %s of %s %s", plugin.name, plugin.distribution, problem)
    return Loaded(tuple(plugin for plugin in installed() if plugin not in problems), problems)


def refused_packages() -> frozenset[str]:
    """The packages whose plugins are all left out, as far as they have been imported."""
    if not load.cache_info().currsize:
        return frozenset()
    usable = {_OURS, *(plugin.package for plugin in load().plugins)}
    return frozenset(plugin.package for plugin in load().problems) - usable


def plugin_of(cls: type) -> Plugin | None:
    """The plugin to which a class belongs; None for our classes and those of users' files."""
    package = _package(cls.__module__)
    same = [each for each in installed() if each.package == package] if package != _OURS else []
    return max(same, key=lambda each: f"{cls.__module__}.".startswith(f"{each.module}."), default=None)


def used_by(names: Iterable[str], nodes: Mapping[str, str]) -> dict[str, str]:
    """Of the names of classes in a scenario, those of plugins, each with its distribution.

    nodes: names of classes of nodes that are not shipped, each with its file
    """
    of_nodes: dict[str, str] = {}
    for name, file in nodes.items():
        if (plugin := node_folders().get(Path(file).parent)) is not None:
            of_nodes[name] = plugin.distribution
    if not load.cache_info().currsize:  # all other names are those of other classes
        return of_nodes
    known = {cls.__name__: plugin.distribution for plugin in load().plugins for cls in _classes_of(plugin)}
    return {name: known[name] for name in sorted(set(names) & known.keys())} | of_nodes


def versions_of(distributions: Iterable[str]) -> dict[str, str]:
    """Versions here of these distributions of plugins, with a digest of their files.

    distributions: their names, with a version or without; others than plugins are left out
    """
    names = {each.partition(" ")[0] for each in distributions}
    found: dict[str, tuple[str, set[str]]] = {}
    for plugin in installed():
        if plugin.project in names:
            version = plugin.distribution.removeprefix(f"{plugin.project} ")
            found.setdefault(plugin.project, (version, set()))[1].add(plugin.package)
    return {name: f"{version} (sources {_digest(frozenset(packages))})" for name, (version, packages) in found.items()}


@cache
def _digest(packages: frozenset[str]) -> str:
    """12 hexadecimal digits of the files of packages."""
    import hashlib  # slow to load

    digest = hashlib.blake2b(digest_size=6)
    for package in sorted(packages):
        spec = importlib.util.find_spec(package)
        for place in map(Path, () if spec is None else spec.submodule_search_locations or [spec.origin or ""]):
            files = [place] if place.is_file() else sorted(place.rglob("*"))
            for file in (each for each in files if each.is_file() and "__pycache__" not in each.parts):
                name = file.relative_to(place.parent).as_posix()
                digest.update(name.encode() + b"\0" + hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


def classes_for(used: Mapping[str, str], base: type) -> list[Any]:
    """The concrete classes of a base in the plugins of a run; used: as from `used_by`"""
    plugins = [plugin for plugin in load().plugins if plugin.distribution in used.values()] if used else []
    classes = [cls for plugin in plugins for cls in _classes_of(plugin)]
    return [cls for cls in classes if issubclass(cls, base) and not inspect.isabstract(cls)]


#: By name of a class, the distribution of its plugin, from the run that uses it.
_expected: dict[str, str] = {}


def expect(classes: Mapping[str, str]) -> None:
    """Name these distributions, by class, in the errors for classes that are not installed here."""
    _expected.update(classes)


def not_found(
    problem: str, name: str, known: Iterable[str] = (), otherwise: type[MastError] = ConfigurationError
) -> MastError:
    """The error for a name that no class has: a PluginError if its class may be in a plugin.

    problem: what was not found;  known: names for the hint;  otherwise: the error if no plugin may have it
    """
    if name in _expected and all(plugin.distribution != _expected[name] for plugin in installed()):
        reason = f"it is in the plugin {_expected[name]}, which this host does not have: install it here"
        return PluginError(f"{problem}: {reason}")
    project = DATA_SETS_PLUGIN if name in DATA_SETS else ROS2_PLUGIN if name in _OF_ROS2 else ""
    if project and not is_installed(project):
        use = f"reading {DATA_SETS[name].reads}" if name in DATA_SETS else "ROS 2"
        return PluginError(f"{problem}: {use} needs the plugin {project}, expected: {command_for(project)}")
    reasons = [f"the plugin {each.name} of {each.distribution} {why}" for each, why in load().problems.items()]
    cause = f": {'; '.join(reasons)}" if reasons else ""
    return (PluginError if reasons else otherwise)(f"{problem}{cause}{nearest(name, known)}")


def is_installed(project: str) -> bool:
    """Whether a distribution with plugins is installed."""
    return any(plugin.project == project for plugin in installed())


def command_for(project: str) -> str:
    """The command that installs one of our plugins."""
    name = project.rpartition("-")[2]
    sources = _SOURCES / name
    return f"pip install -e {sources}" if sources.is_dir() else f"pip install 'mast-zenoh[{name}]'"


def required(module: str, project: str) -> Any:
    """A module of one of our plugins; raises PluginError if that, or what it requires, is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (missing := _package(error.name or "")) == _OURS:
            raise
        needed = f"needs the plugin {project}, expected: {command_for(project)}"
        raise PluginError(f"{missing} is not installed: this {needed}") from None


@cache
def node_folders() -> dict[Path, Plugin]:
    """The folders `nodes` in the packages of plugins, found without an import."""
    folders: dict[Path, Plugin] = {}
    for plugin in installed():
        spec = importlib.util.find_spec(plugin.package) if plugin.package != _OURS else None
        for place in (spec and spec.submodule_search_locations) or ():
            if (folder := Path(place).resolve() / "nodes").is_dir():
                folders.setdefault(folder, plugin)
    return folders


class DataSet(NamedTuple):
    """A class of our plugin for data sets: the short name of its scenes, and what it reads."""

    short_name: str
    reads: str


#: The classes of our plugin for data sets, for the error if it is not installed.
DATA_SETS = {
    "AVstackScene": DataSet("avstack", "the CARLA layout of AVstack"),
    "AV2Log": DataSet("av2", "Argoverse 2"),
    "KittiTracking": DataSet("kitti", "KITTI"),
    "CommonRoadScenario": DataSet("commonroad", "CommonRoad"),
    "SumoTraffic": DataSet("sumo", "configurations of SUMO"),
    "SumoTrace": DataSet("sumo", "traces of SUMO"),
    "OPV2VScene": DataSet("opv2v", "OPV2V"),
    "V2XRealScene": DataSet("v2xreal", "V2X-Real"),
    "MultiV2XScene": DataSet("multiv2x", "Multi-V2X"),
    "V2V4RealScene": DataSet("v2v4real", "V2V4Real"),
    "DAIRScene": DataSet("dair", "DAIR-V2X-C and V2X-Seq-SPD"),
    "RCooperScene": DataSet("rcooper", "RCooper"),
    "TUMTrafV2X": DataSet("tumtraf", "TUMTraf V2X"),
    "UrbanIngV2X": DataSet("urbaning", "UrbanIng-V2X"),
    "RosBag": DataSet("rosbag", "ROS 2 bags"),
}


def _package(module: str) -> str:
    return module.partition(".")[0]


def _classes_of(plugin: Plugin) -> list[type]:
    """The classes of an imported plugin that derive from ours."""
    modules = [module for name, module in list(sys.modules.items()) if _package(name) == plugin.package]
    return [
        cls
        for module in modules
        for cls in vars(module).values()
        if isinstance(cls, type) and cls.__module__ == module.__name__ and any(map(_is_ours, cls.__mro__))
    ]


def _is_ours(cls: type) -> bool:
    return _package(cls.__module__) == _OURS


def _clash(cls: type, packages: Collection[str]) -> str:
    """Which other class in these packages has the name or short name of `cls`, as words; "": none.

    Only classes count that derive from one of our classes as `cls` does.
    """
    short: str | None = vars(cls).get("short_name")
    for base in filter(_is_ours, cls.__mro__):
        for other in (base, *subclasses(base)):
            if other is cls or _package(other.__module__) not in packages:
                continue
            place = f"{other.__module__}.{other.__name__}"
            if other.__name__ == cls.__name__:
                return f"its class {cls.__name__} has the name of {place}"
            if short and vars(other).get("short_name") == short:
                return f"its class {cls.__name__} has the short name {short!r} of {place}"
    return ""


def subclasses(base: type) -> Iterator[type[Any]]:
    """All classes that derive from one."""
    direct: list[type[Any]] = base.__subclasses__()
    for subclass in direct:
        yield subclass
        yield from subclasses(subclass)
