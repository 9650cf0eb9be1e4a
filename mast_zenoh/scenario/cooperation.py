"""Checks that options of peers and centres, and the maps that they need, fit each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.fusion.regions import ServedArea
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.node import Node
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.scenario.nodes import takes
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.v2x import CpmGeneration, EveryFrame
from mast_zenoh.v2x.station import Station
from mast_zenoh.wiring.maps import Sources
from mast_zenoh.wiring.model import Wiring


def check_cooperation(
    path: Path,
    nodes: Mapping[str, tuple[NodeSpec, Node]],
    sources: Sources,
    wiring: Wiring,
    period_ns: int,
) -> None:
    """Raise ConfigurationError for an option without the other one, or the map, that it needs.

    nodes: of the run, with what was built of each;  sources: the map and its rewrites;  period_ns: between two frames
    """
    specs = {name: spec for name, (spec, _) in nodes.items()}
    _check_channel(path, specs, sources)
    _check_awareness(path, specs, sources)
    for wire in wiring.wires:
        agent = specs.get(wire.subject)
        if wire.codec == "cpm" and agent is not None and takes(agent, "tracks_from"):
            found = agent.config.get("tracks_from", "world")
            if found != "agent":
                raise ConfigurationError(
                    f"{path}: agents.{wire.subject}.tracks_from: found {found!r} with the codec cpm on {wire.key!r}, "
                    "expected 'agent': otherwise its messages are those of a roadside unit at the origin of the scene"
                )
    for spec, node in nodes.values():
        if spec.role == "peer" and isinstance(station := getattr(node, "station", None), Station):
            _check_ages(f"{path}: peers.{spec.config['agent']}", spec, station, period_ns)


def _check_channel(path: Path, specs: Mapping[str, NodeSpec], sources: Sources) -> None:
    """The channel, and what carries its words to peers."""
    exists = any(spec.role == "channel" for spec in specs.values())
    places = list(_wires_from(sources, lambda publisher: publisher.startswith("channel.")))
    if exists and not places:
        raise ConfigurationError(
            f"{path}: channel: no map has a wire from it, so that nothing is lost: "
            "add channel.toml to keyexpr.rewrites, or leave `channel` out"
        )
    if places and not exists:
        raise ConfigurationError(
            f"{path}: keyexpr.rewrites: found {places[0]}, but the scenario has no `channel`: "
            "add channel=dict(), or leave the map out"
        )


def _check_awareness(path: Path, specs: Mapping[str, NodeSpec], sources: Sources) -> None:
    """What vehicles say of themselves, and what carries it to peers."""
    peers = [spec for spec in specs.values() if spec.role == "peer"]
    places = list(_wires_from(sources, "peer.awareness".__eq__))
    for spec in peers:
        if spec.config.get("awareness") is not None and not places:
            raise ConfigurationError(
                f"{path}: peers.{spec.config['agent']}.awareness: no map has a wire for it: "
                "add awareness.toml to keyexpr.rewrites, or leave awareness out"
            )
    if places and all(takes(spec, "awareness") and spec.config.get("awareness") is None for spec in peers):
        raise ConfigurationError(
            f"{path}: keyexpr.rewrites: found {places[0]}, but no peer has `awareness`: "
            'add awareness=dict(type="CamGeneration") to peers, or leave the map out'
        )


def _wires_from(sources: Sources, matches: Callable[[str], bool]) -> Iterator[str]:
    """The files of maps that have wires of some publishers (role.port)."""
    return (file for file, content in sources for entry in content.get("wire", ()) if matches(str(entry["from"])))


def _check_ages(place: str, spec: NodeSpec, station: Station, period_ns: int) -> None:
    """How long what a peer hears is used, beside how often others send it."""
    memory_s, max_age_s = spec.config.get("memory_s", 0.0), spec.config.get("max_age_s", MAX_AGE_S)
    if round(max_age_s * 1e9) < period_ns:
        raise ConfigurationError(
            f"{place}.max_age_s: found {max_age_s}, expected at least {period_ns * 1e-9:g} s, the time between two "
            "frames: what a peer hears is used from the next frame on"
        )
    rules, kind = station.rules, type(station.rules).__name__
    if isinstance(rules, EveryFrame):
        return
    if not isinstance(rules, CpmGeneration):
        if "memory_s" not in spec.config:
            raise ConfigurationError(
                f"{place}.memory_s: found none with the rules {kind}: objects that a message leaves out vanish; "
                "expected the longest time, s, between two messages with an object, or 0 if every message has all"
            )
    elif not rules.send_all:
        for name, value in (("memory_s", memory_s), ("max_age_s", max_age_s)):
            if value < rules.most_s:
                raise ConfigurationError(
                    f"{place}.{name}: found {value} with the rules {kind}, which leave an unchanged object out for "
                    f"up to most_s = {rules.most_s:g} s: expected more than that, such as {1.2 * rules.most_s:g}"
                )


def uncovered(nodes: Mapping[str, tuple[NodeSpec, Node]], recording: Recording, frames: int) -> Iterator[Finding]:
    """Yield a finding if some true objects are in the region of no centre. frames: that are played"""
    centers = [node for spec, node in nodes.values() if spec.role == "center"]
    areas = [(getattr(node, "region", None), getattr(node, "overlap_m", 0.0)) for node in centers]
    fixed = [(region, margin_m) for region, margin_m in areas if isinstance(region, ServedArea) and not region.follows]
    if not areas or len(fixed) < len(areas):
        return
    position = recording.truth.position[: recording.truth_start[frames]]
    outside = ~np.any([region.contains(position, margin_m) for region, margin_m in fixed], axis=0)
    if outside.any():
        (x, y), share = position[outside][0, :2], outside.mean()
        first = f"x {x:.1f}, y {y:.1f} m"
        yield Finding("idle", ("centers",), "uncovered", float(100.0 * share), unit="%", where=first)
