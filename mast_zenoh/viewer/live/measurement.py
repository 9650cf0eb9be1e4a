"""One frame of a running run, measured as the evaluator measures it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from mast_zenoh.config import bundle, loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.messages import codec
from mast_zenoh.messages.limits import RowLimits
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.runtime.host import Host
from mast_zenoh.viewer.live.reception import Sample
from mast_zenoh.viewer.routes import CLOCK, routes
from mast_zenoh.wiring.model import ANY, Endpoint, Wiring

#: Parameters of the evaluator that decide how a frame is measured; the others only concern summaries of runs.
_PARAMETERS = ("agents", "scorer", "attribution", "cut_off", "picture_age_s", "picture_ages_s")
_NAME = "evaluator"
#: The run's own nodes log what they refuse; the page counts it.
_SILENT = logging.getLogger("mast.viewer.silent")
_SILENT.disabled = True


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A frame.

    number:  its index in the run;  time_ns: its time, ns since the scene began
    bodies:  by series, the columns of the first valid message about it
    tables:  the evaluator's tables, with the columns of the files of a run: metrics, objects, attacks; trust and
             trust_objects where a command centre judges agents
    same_as: by agent, estimates with the same messages as others
    refused: number of messages about it that receivers refuse
    """

    number: int
    time_ns: int
    bodies: Mapping[Series, Body]
    tables: Mapping[str, Mapping[str, Any]]
    same_as: Mapping[str, Mapping[str, str]]
    refused: int


@cache
def evaluator_class() -> type[Any]:
    """The shipped evaluator; the first call takes some time, as it loads what an evaluation needs."""
    file = bundle.find("nodes", "evaluator.py")
    assert file is not None  # it is part of the package
    return loading.node_class(file, "Evaluator")


class FrameMeter:
    """Measures frames of a run, each on its own: what changes over time, such as id switches, it does not know.

    resolved: the run's scenario, with the user's modules loaded if they are available
    notes:    what differs from the run's own measurement
    """

    def __init__(self, resolved: Resolved) -> None:
        self._resolved = resolved
        self.notes: list[str] = []
        self._evaluator = evaluator_class()
        config = resolved.nodes[_NAME].config if _NAME in resolved.nodes else {}
        self._config = {name: value for name, value in config.items() if name in _PARAMETERS}
        self.agents = tuple(str(name) for name in self._config.get("agents", ()))
        try:
            self._build()
        except ConfigurationError as error:  # a user's class, which is not on this machine
            self.notes.append(f"scored with the default settings, because the run's own cannot be used: {error}")
            self._config = {"agents": list(self.agents)}

    def keys(self, wiring: Wiring) -> dict[str, str]:
        """The keys whose messages a frame needs, with their message types."""
        node = self._host(wiring)[1]
        needed = node.routes.keys() | node.metered | routes(wiring, self.agents).keys()
        return {leg.key: wire.message for wire, leg in wiring.legs() if leg.key in needed}

    def clock_key(self, wiring: Wiring) -> str:
        """The key of the clock; "": none."""
        return next((key for key, series in routes(wiring, self.agents).items() if CLOCK in series), "")

    def measure(
        self, number: int, messages: Iterable[tuple[str, Sample]], wiring: Wiring, roles: Mapping[str, str]
    ) -> MeasuredFrame | None:
        """Measure a frame; None if its clock is not among the messages.

        messages: those about this frame, perhaps among others;  roles: of all nodes
        """
        host, node = self._host(wiring)
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        series_by_key = routes(wiring, self.agents)
        timespan = self._resolved.timespan
        bodies: dict[Series, Body] = {}
        time_ns, refused = -1, 0
        for name, role in roles.items():
            if name != _NAME:
                host.joined(name, role)
        for key, sample in messages:
            if key not in types:
                continue
            try:
                if codec.decode_header_only(sample.payload, types[key]).frame != number:
                    continue
                message = codec.decode(sample.payload, types[key])
            except MessageError:
                refused += sample.step == number
                continue
            if timespan is not None and timespan.refusal(message.header, sample.step):
                refused += 1
                continue
            if CLOCK in series_by_key.get(key, ()) and time_ns < 0:
                time_ns = message.header.time_ns
            for series in series_by_key.get(key, ()):
                bodies.setdefault(series, message.body)
            host.deliver(key, sample.payload, sample.step, counted=False)
        if time_ns < 0:
            return None
        tables = node.evaluation.frame_tables(node.data)
        same_as = tables.pop("same_as")
        return MeasuredFrame(number, time_ns, bodies, tables, same_as, refused)

    def _build(self) -> Any:
        return registry.construct(self._evaluator, self._config, f"scenario.json: {_NAME}")

    def _host(self, wiring: Wiring) -> tuple[Host, Any]:
        """A new evaluator that receives every key of a wiring."""
        node = self._build()
        port = next(port for port, message in node.inputs.items() if message == ANY)
        observed = Wiring(wiring.wires, (Endpoint(_NAME, port),))
        resolved = self._resolved
        host = Host(
            _NAME,
            node,
            observed.ports(_NAME),
            resolved.seed,
            encode=True,
            emit=lambda out: None,
            period_ns=resolved.period_ns,
            wiring=observed,
            timespan=resolved.timespan,
        )
        host.limits = RowLimits(resolved.max_rows)
        host.log = _SILENT
        host.start({})
        return host, node
