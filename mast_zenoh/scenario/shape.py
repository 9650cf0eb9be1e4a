"""The shape of a scenario: its keys and the types of their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.config.settings import ALIASES, KEYS
from mast_zenoh.errors import ConfigurationError, nearest

MODES = ("lockstep", "realtime")

#: The `run` part of a scenario.
RUN_DEFAULTS: dict[str, Any] = {
    "mode": "lockstep",
    "rate": 1.0,
    "frames": None,
    "seed": 0,
    "record": True,
    "max_rows": None,
}
#: Keys whose values are dicts; `coordinator` may be None.
_DICTS = (
    *("broker", "command_center", "evaluator", "coordinator"),
    *("agents", "adversaries", "nodes", "links", "hosts", "keyexpr", "run"),
)


def normalise_keys(scenario: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The scenario with alternative spellings of keys replaced by the usual ones."""
    renamed = {ALIASES.get(key, key): value for key, value in scenario.items()}
    if len(renamed) < len(scenario):
        duplicates = [f"{key} and {usual}" for key, usual in ALIASES.items() if {key, usual} <= scenario.keys()]
        raise ConfigurationError(f"{place}: {', '.join(duplicates)} are the same: expected one of them")
    return renamed


def checked(scenario: Mapping[str, Any], place: str) -> Mapping[str, Any]:
    """Return a scenario; raises ConfigurationError for invalid keys or values."""
    for key, value in scenario.items():
        if key not in KEYS:
            raise ConfigurationError(f"{place}: {key}: unknown key{nearest(str(key), KEYS)}")
        if key == "coordinator" and value is None:
            continue
        if key in _DICTS and not isinstance(value, Mapping):
            raise ConfigurationError(f"{place}: {key}: found {value!r}, expected a dict")
    return scenario


def check_run(options: Mapping[str, Any], place: str) -> None:
    """Raise ConfigurationError for an invalid `run` part."""
    for key in options:
        if key not in RUN_DEFAULTS:
            raise ConfigurationError(f"{place}: run.{key}: unknown key{nearest(key, RUN_DEFAULTS)}")
    if options["mode"] not in MODES:
        raise ConfigurationError(f"{place}: run.mode: found {options['mode']!r}{nearest(str(options['mode']), MODES)}")
    if type(options["seed"]) is not int or options["seed"] < 0:
        raise ConfigurationError(f"{place}: run.seed: found {options['seed']!r}, expected a whole number from 0")
    if options["frames"] is not None and (type(options["frames"]) is not int or options["frames"] < 1):
        raise ConfigurationError(f"{place}: run.frames: found {options['frames']!r}, expected a whole number from 1")
    rows = options["max_rows"]
    if rows is not None and (type(rows) is not int or rows < 1):
        raise ConfigurationError(f"{place}: run.max_rows: found {rows!r}, expected a whole number from 1")
    if type(options["record"]) is not bool:
        raise ConfigurationError(f"{place}: run.record: found {options['record']!r}, expected True or False")
    if not isinstance(options["rate"], (int, float)) or not 0 < options["rate"] < float("inf"):
        raise ConfigurationError(f"{place}: run.rate: found {options['rate']!r}, expected a number above 0")
