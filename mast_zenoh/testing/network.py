"""Checks of link rules and faults."""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np

from mast_zenoh.config import registry
from mast_zenoh.config.process_steps import ACTIONS
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.faults.base import Fault
from mast_zenoh.links import FATES, Passage, Rule, SenderPose, Sensed
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect


def check_link_rule(rule: Rule) -> None:
    """Check a link rule with zero, one and a thousand messages.

    It must fulfil what the documentation of `Rule` promises.

    rule: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    subject = type(rule).__name__
    fate = getattr(rule, "fate", None)
    expect(fate in FATES, f"{subject}.fate: found {fate!r}, expected one of {', '.join(FATES)}")
    for n in samples.COUNTS:
        expect(
            _passages(rule, n) == _passages(rule, n), f"{subject}: the results of two copies differ for the same draws"
        )


def _passages(rule: Rule, n: int) -> list[tuple[Passage, ...]]:
    """The passages of n messages through a rule."""
    subject = type(rule).__name__
    rule, random = copy.deepcopy(rule), np.random.default_rng(n)
    rows = rule.sample(random, n)
    expect(len(rows) == n, f"{subject}.sample: found {len(rows)} rows of draws for {n} messages")
    results = []
    for index, row in enumerate(rows.tolist()):
        now = index * samples.PERIOD_NS
        position = np.zeros(3) if rule.needs_position else None
        size = 1000 if rule.needs_size else 0
        message = Passage(now, now, size=size, position=position, referenced=rule.needs_frame, sensed=_sensed(rule))
        copies = rule.apply(message, row) if rule.active(now) else (message,)
        expect(
            isinstance(copies, tuple), f"{subject}.apply: found {type(copies).__name__}, expected a tuple of passages"
        )
        for passage in copies:
            expect(isinstance(passage, Passage), f"{subject}.apply: found {type(passage).__name__}, expected a Passage")
            expect(passage.delay_ns >= message.delay_ns, f"{subject}.apply: a message leaves before it arrives")
            draws = rule.sample_copy(row, random)
            expect(len(draws) == len(row), f"{subject}.sample_copy: found {len(draws)} draws, expected {len(row)}")
        results.append(tuple(passage._replace(position=None, sensed=_comparable(passage)) for passage in copies))
    return results


def _sensed(rule: Rule) -> Sensed | None:
    """Detections for a rule that needs them."""
    if not rule.needs_detections:
        return None
    pose = SenderPose(0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 0.0)
    return Sensed(samples.detections(3), np.zeros(3), np.eye(3), pose)


def _comparable(passage: Passage) -> Any:
    """The detections of a passage, to compare them with others'."""
    if passage.sensed is None:
        return None
    return tuple(column.tobytes() for column in passage.sensed.detections.columns().values())


def check_fault(fault: Fault) -> None:
    """Check that a fault acts on messages or processes, with valid rules and actions.

    Raises AssertionError.
    """
    subject = type(fault).__name__
    expect(
        fault.over is None or fault.over >= fault.at,
        f"{subject}.over: found {fault.over}, expected {fault.at} or later",
    )
    events = fault.events()
    for lockstep in (True, False):
        rules = fault.rules(lockstep)
        expect(rules or events, f"{subject}: found neither rules nor events, expected one of them")
        expect(rules == fault.rules(lockstep), f"{subject}.rules: two calls return different rules")
        for index, rule in enumerate(rules):
            try:
                registry.build({**rule, "at": fault.at, "until": fault.over}, Rule, f"{subject}.rules[{index}]")
            except ConfigurationError as error:
                raise AssertionError(str(error)) from error
    for time_s, action in events:
        expect(action in ACTIONS, f"{subject}.events: found {action!r}, expected one of {', '.join(ACTIONS)}")
        expect(time_s >= fault.at, f"{subject}.events: {action} at {time_s} s, expected {fault.at} s or later")
    ascending = all(first[0] <= second[0] for first, second in pairwise(events))
    expect(ascending, f"{subject}.events: not sorted by time")
