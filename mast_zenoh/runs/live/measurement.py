"""A running run, frame by frame, measured as the evaluator measures it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from mast_zenoh.config import bundle, loading, registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MessageError
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.measurement import listening_host
from mast_zenoh.mesh.host import Host
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.run_folder.tables import as_read, to_arrow
from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.address import LiveAddress
from mast_zenoh.runs.live.reception import Sample
from mast_zenoh.runs.routes import CLOCK, routes
from mast_zenoh.runs.run import Run
from mast_zenoh.wiring.model import ANY, Endpoint, Wiring

#: Parameters of the evaluator that decide how a frame is measured; the others only concern summaries of runs.
_PARAMETERS = ("agents", "scorer", "attribution", "cut_off", "picture_age_s", "picture_ages_s")
_NAME = "evaluator"
#: The run's own nodes log what they refuse; the page counts it.
_SILENT = logging.getLogger("mast.viewer.silent")
_SILENT.disabled = True


def seen(run: LiveAddress, wiring: Wiring, agents: Iterable[str]) -> Run:
    """A run that is going on, before its first frame. wiring: the current one;  agents: their names

    Its topics are those of the wiring at the beginning. A node that is inserted later is seen by its changes.
    """
    files = RunFiles(
        None,
        record={"id": run.id, "name": run.resolved.name, "seed": run.resolved.seed, "status": RUNNING},
        scenario=run.resolved.to_json(),
        wiring=wiring.to_json(),
        wirings=[(-1, wiring)],
        summary={"agents": dict.fromkeys(agents)},
        scene=run.scene,
    )
    return Run.of(files)


def as_of(run: Run, tables: Mapping[str, Any]) -> Run:
    """A run that is going on as of one frame, which alone its tables have: of trust, the latest rows.

    tables: of the evaluator
    """
    read = {name: as_read(tables[name]) for name in tables if name not in ("objects", "same_as")}
    return run.with_(
        summary={"agents": run.files.summary["agents"], "same_as": tables["same_as"]},
        counts=read["metrics"],
        all_objects=to_arrow(tables["objects"]),
        effects=read["attacks"],
        trust=read.get("trust", run.files.trust),
        trust_objects=read.get("trust_objects"),
    )


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

    def keys_of_series(self, wiring: Wiring) -> dict[str, list[Series]]:
        """The keys whose messages a frame has, and the series on each."""
        return routes(wiring, self.agents)

    def clock_key(self, wiring: Wiring) -> str:
        """The key of the clock; "": none."""
        return next((key for key, series in routes(wiring, self.agents).items() if CLOCK in series), "")

    def measure(
        self,
        run: Run,
        number: int,
        messages: Iterable[tuple[str, Sample]],
        wiring: Wiring,
        roles: Mapping[str, str],
    ) -> Frame | None:
        """Measure a frame; None if its clock is not among the messages.

        run:      as of an earlier frame;  roles: of all nodes
        messages: those about this frame, perhaps among others
        """
        frame, sound = self._decoded(run, number, messages, wiring)
        if frame is None:
            return None
        host, node = self._host(wiring)
        for name, role in roles.items():
            if name != _NAME:
                host.joined(name, role)
        for key, sample in sound:
            host.deliver(key, sample.payload, sample.step, counted=False)
        return replace(frame, run=as_of(run, node.evaluation.frame_tables(node.data)))

    def unmeasured(self, run: Run, number: int, messages: Iterable[tuple[str, Sample]], wiring: Wiring) -> Frame | None:
        """A frame as `measure` makes it, in a small part of the time: no object is evaluated."""
        return self._decoded(run, number, messages, wiring)[0]

    def _decoded(
        self, run: Run, number: int, messages: Iterable[tuple[str, Sample]], wiring: Wiring
    ) -> tuple[Frame | None, list[tuple[str, Sample]]]:
        """A frame with what its messages hold, None without a clock; and those messages that receivers accept."""
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        series_by_key = routes(wiring, self.agents)
        timespan = self._resolved.timespan
        bodies: dict[Series, Body] = {}
        sound: list[tuple[str, Sample]] = []
        time_ns, refused = -1, 0
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
            sound.append((key, sample))
        return None if time_ns < 0 else Frame(run, number, time_ns, bodies, refused), sound

    def _build(self) -> Any:
        return registry.construct(self._evaluator, self._config, f"scenario.json: {_NAME}")

    def _host(self, wiring: Wiring) -> tuple[Host, Any]:
        """A new evaluator that receives every key of a wiring."""
        node = self._build()
        port = next(port for port, message in node.inputs.items() if message == ANY)
        observed = replace(wiring, overhearers=(Endpoint(_NAME, port),))
        host = listening_host(self._resolved, _NAME, node, observed)
        host.log = _SILENT
        host.start({})
        return host, node
