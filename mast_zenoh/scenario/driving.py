"""The drivers of a scenario, the world that obeys them, and the wires between them."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.config import registry
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.driving import CarLimits
from mast_zenoh.driving.driver import ESTIMATE_AGE_S
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import Recording, Scene
from mast_zenoh.scenes.base import check_cars

#: The map of the wires of drivers; added where a scenario has drivers.
MAP = "driving.toml"
#: ns, the longest period of a scene with drivers; 5 Hz: a car of 50 km/h drives 2.8 m in it.
_SLOWEST_NS = 200_000_000
#: File of the simulator that is stepped.
_WORLD = "world.py"
#: The map of the wires by which an agent tells what its sensor sees; added where a driver's own sensors have a veto.
VIEWS = "views.toml"


def driver_of_car(car: str) -> str:
    """The name of the node that drives the car of an agent."""
    return f"driver_{car}"


def simulator_config(
    path: Path, scenario: Mapping[str, Any], recording: Recording, frames: int, spec: Mapping[str, Any]
) -> dict[str, Any]:
    """The configuration of the simulator: with drivers it is a world.

    spec: of the scene
    Raises ConfigurationError for a scene that cannot be stepped, or too slowly, an agent without a car, a driver that
    never has an estimate, and a `world` without drivers.
    """
    config = {"recording": recording, "frames": frames}
    drivers, options = scenario.get("drivers", {}), scenario.get("world", {})
    if not drivers:
        if options:
            raise ConfigurationError(
                f"{path}: world: found {dict(options)!r}, expected `drivers` beside it: it obeys them"
            )
        return config
    for key in ("recording", "scene", "frames", "drivers"):
        if key in options:
            raise ConfigurationError(f"{path}: world.{key}: it follows from the scenario: leave it out")
    if type(registry.build(spec, Scene, f"{path}: scene")).world is Scene.world:
        raise ConfigurationError(
            f"{path}: drivers: a scene of the type {spec['type']} cannot be stepped, so its cars cannot be driven: "
            "expected Intersection, StraightRoad (road:CASE), SumoTraffic (sumo:FILE.sumocfg), or a scene of yours "
            "that defines `world`"
        )
    if recording.period_ns > _SLOWEST_NS:
        raise ConfigurationError(
            f"{path}: drivers: found a scene of {1e9 / recording.period_ns:g} Hz, expected {1e9 / _SLOWEST_NS:g} Hz or "
            "more (rate_hz of the scene): from one frame to a much later one cars drive through each other unnoticed"
        )
    _check_ages(path, drivers, recording.period_ns)
    if recording.measurements is not None:
        timed = np.flatnonzero(recording.measurements.age_ns.any(axis=0))
        found = ", ".join(recording.sensor_names[column] for column in timed[:5])
        raise ConfigurationError(
            f"{path}: drivers: {found} measure at times of their own: expected sensors without rate_hz and phase_s, as "
            "a scene with drivers is stepped frame by frame"
        )
    try:
        check_cars(drivers, [agent.name for agent in recording.agents if agent.kind == "mobile"])
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    names = {car: driver_of_car(car) for car in drivers}
    # The world reads the scene's files itself, in a process of another folder.
    scene = {key: os.path.abspath(value) if key == "path" else value for key, value in spec.items()}
    return {"file": _WORLD, **config, "scene": scene, "drivers": names, **options}


def _check_ages(path: Path, drivers: Mapping[str, Any], period_ns: int) -> None:
    """Raise ConfigurationError for a driver that finds every estimate too old: it uses those of earlier frames."""
    for car, config in drivers.items():
        age_s = config.get("estimate_age_s", ESTIMATE_AGE_S) if isinstance(config, Mapping) else ESTIMATE_AGE_S
        if isinstance(age_s, (int, float)) and age_s <= (period_ns - 1) * 1e-9:
            raise ConfigurationError(
                f"{path}: drivers.{car}.estimate_age_s: found {age_s:g}, expected {period_ns * 1e-9:g} or more, a "
                "frame of this scene: a driver uses estimates of earlier frames, and without one it only brakes"
            )


def drivers(path: Path, scenario: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield (name, configuration) of each driver's node; its limits are those of the world by default.

    Raises ConfigurationError for a driver that may command more than its car can do: all such commands are refused.
    """
    of_world = scenario.get("world", {}).get("limits")
    can = _limits(of_world, f"{path}: world.limits")
    for car, config in scenario.get("drivers", {}).items():
        if not isinstance(config, Mapping):
            raise ConfigurationError(f"{path}: drivers.{car}: found {config!r}, expected a dict")
        if config.get("limits") is None:
            config = {**config, "limits": of_world} if of_world is not None else config
        else:
            believed = _limits(config["limits"], f"{path}: drivers.{car}.limits")
            for name, most in vars(can).items():
                if vars(believed)[name] > most:
                    raise ConfigurationError(
                        f"{path}: drivers.{car}.limits.{name}: found {vars(believed)[name]:g}, expected at most "
                        f"{most:g}, as in world.limits: the car refuses commands beyond what it can do"
                    )
        yield driver_of_car(car), {"agent": car, **config}


def described_drivers(path: Path, scenario: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """By agent, the driver of its car and the limits that it believes; nodes of another file are left out."""
    configs = [config for _, config in drivers(path, scenario) if "driver" in config and "file" not in config]
    return {config["agent"]: {key: config[key] for key in ("driver", "limits") if key in config} for config in configs}


def evaluator_config(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """What the evaluator knows of the drivers and their world, where the scenario says it."""
    drivers, world = scenario.get("drivers", {}), scenario.get("world", {})
    ages = {car: config["estimate_age_s"] for car, config in drivers.items() if "estimate_age_s" in config}
    keys = {"take_over_s": "take_over_s", "hold_s": "hold_s", "car_limits": "limits"}
    known = {name: world[key] for name, key in keys.items() if key in world}
    return known | ({"estimate_ages_s": ages} if ages else {})


def _limits(spec: object, path: str) -> CarLimits:
    limits: CarLimits = CarLimits() if spec is None else registry.build(spec, CarLimits, path)
    return limits


def rewrites(nodes: Mapping[str, NodeSpec], inputs: Mapping[str, Collection[str]]) -> list[str]:
    """The maps that connect drivers with the world, and with what they know. inputs: ports by node"""
    drivers = [name for name, spec in nodes.items() if spec.role == "driver"]
    views = [VIEWS] if any("view" in inputs[name] for name in drivers) else []
    return [MAP, *views] if drivers else []
