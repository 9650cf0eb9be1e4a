"""Shows a running run in browsers, one block a frame, until it has ended; then all of it."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.errors import MastError
from mast_zenoh.metrics.estimates import ESTIMATORS
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.address import LiveAddress
from mast_zenoh.runs.live.observer import POLL_S, Observer
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import truth_states
from mast_zenoh.show.page.block import AgentPoses, judgements_of, pack_frames
from mast_zenoh.show.page.columns import Packer
from mast_zenoh.show.page.live_server import Feed, LiveServer
from mast_zenoh.show.page.motion import motion_of
from mast_zenoh.show.page.page import policy, viewer_page

#: s in which a finished run must have its results.
_RESULTS_S = 60.0
#: s after which a page that does not read is taken as stopped.
_PATIENCE_S = 2.0
#: Parts of the header that rarely change: the page gets them once, and again when they change.
LASTING = (
    *("format", "id", "label", "ego", "centre", "scored", "gate_m", "range_m", "classes", "colours", "estimates"),
    *("buildings", "tops", "agents", "states", "flags", "judged", "effects", "recorded"),
)


class LiveBlocks:
    """Makes blocks of the frames of an observed run."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        #: By agent, its latest position (3,) m and rotation (3, 3), which later frames may not repeat.
        self._poses: dict[str, tuple[Floats, Floats]] = {}
        if (scene := observer.address.scene) is not None:
            poses = zip(scene.agent_position[0], scene.agent_rotation[0], strict=True)
            self._poses = dict(zip(scene.agent_names, poses, strict=True))

    def header_and_block(self, frame: Frame) -> tuple[dict[str, Any], bytes]:
        """The lasting part of the header of a frame, and the block with everything else.

        Raises ValueError if a number is too large for a block.
        """
        down = [{"node": node, "action": "kill", "frame": frame.index} for node in self._observer.down]
        run = frame.run.with_(record={**frame.run.files.record, "steps": down})
        body = frame.bodies.get(TRUTH) if run.files.scene is not None else None
        states = ObjectStates.empty() if body is None else truth_states(body)
        truth = np.full(len(states), frame.index), states
        judged = judgements_of(run.files.all_objects, truth)
        tracks = [body for series, body in frame.bodies.items() if series.estimator in ESTIMATORS]
        motion = motion_of(judged, truth, ((frame.index, body) for body in tracks))
        packer = Packer()
        packer.add("time", np.array([frame.time_ns * 1e-9]), scale=1e-3)
        frames = range(frame.index, frame.index + 1)
        header = pack_frames(packer, run, judged, motion, self._surroundings(frame), frames)
        header |= {"label": run.name, "recorded": True, "scored": None}
        header |= self._happening(run, frame)
        lasting = {name: header.pop(name) for name in LASTING}
        return lasting, packer.block(header)

    def _happening(self, run: Run, frame: Frame) -> dict[str, Any]:
        """What is said of the run as a whole, up to this frame."""
        observer = self._observer
        record = {**run.files.record, "interceptions": observer.interceptions}
        return {
            "number": frame.index,
            "spans": spans(run.with_(record=record), run.times(np.arange(frame.index + 1))),
            "newest": observer.frame,
            "refused": frame.refused,
            "down": observer.down,
            "notes": observer.meter.notes,
            "wires": [
                {"key": wire.key, "legs": [leg._asdict() for leg in wire.legs], "to": wire.subscribers}
                for wire in observer.wires()
            ],
        }

    def _surroundings(self, frame: Frame) -> AgentPoses | None:
        """The agents as the messages have them."""
        scene = frame.run.files.scene
        if scene is None:
            return None
        self._poses.update({name: pose for name, pose in frame.poses.items() if name in self._poses})
        position, rotation = (np.array([[self._poses[name][part] for name in scene.agent_names]]) for part in (0, 1))
        number = scene.nearest(frame.index)
        roles = {spec.role for spec in self._observer.address.resolved.nodes.values()}
        stepped = "driver" in roles  # the prepared sweeps are of another drive
        sweeps = () if stepped else tuple(sweep[number : number + 1] for sweep in scene.sweeps)
        return AgentPoses(position, rotation, sweeps)


def show(run: LiveAddress, session: zenoh.Session, server: LiveServer, stop: threading.Event) -> None:
    """Show a running run on a server until `stop` is set, also after its end.

    session: a client of the run's router
    """
    observer = Observer(run, session)
    try:
        _follow(observer, server.feed, stop)
    finally:
        observer.close()
    if stop.is_set():
        return
    if run.folder is None or (page := _finished_page(run.folder, stop)) is None:
        server.feed.close(reload=False)
    else:
        server.show_finished(page, policy())
    stop.wait()


def _follow(observer: Observer, feed: Feed, stop: threading.Event) -> None:
    """Publish frames until the run is over; receives nothing but the clock while no page reads them."""
    blocks = LiveBlocks(observer)
    wanted = time.monotonic()
    while not stop.is_set():
        if feed.is_wanted:
            wanted = time.monotonic()
        observer.listen(everything=time.monotonic() - wanted < _PATIENCE_S)
        if not feed.is_wanted:
            observer.keep_up()
        elif (frame := observer.advance()) is not None:
            try:
                feed.publish(*blocks.header_and_block(frame))
            except Exception as error:  # such as numbers that no page can draw: one frame is lost, and the page says so
                observer.note(f"frame {frame.index} cannot be shown: {error!r:.200}")
        feed.note(observer.meter.notes)
        if observer.is_over():
            return
        stop.wait(POLL_S)


def _finished_page(folder: Path, stop: threading.Event) -> bytes | None:
    """The page of the finished run; None: its results do not arrive."""
    deadline = time.monotonic() + _RESULTS_S
    while time.monotonic() < deadline and not stop.is_set():
        with suppress(MastError):
            return viewer_page([folder])
        stop.wait(1.0)
    return None
