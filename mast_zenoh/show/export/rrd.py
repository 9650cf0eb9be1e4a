"""A recording for the Rerun viewer, with a blueprint.

Rerun has 32 bits for a coordinate: positions are relative to the origin of the run's local planes, which the entity
`scene` names. Rerun's `log` may block: no process that a run depends on may call it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as views

from mast_zenoh.arrays.geometry import scalar_last_quaternions
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.recorded import frames_of
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.runs.scans import scans_in
from mast_zenoh.show.export.columns import cameras, class_names, colours, missed, wall_lines
from mast_zenoh.show.palette import ADVERSARY, BUILDING_EDGE, GROUND, OUTCOME_COLOURS, rgb

APPLICATION = "mast-zenoh"
#: Timelines: number of the frame, and time of the scene.
FRAME, TIME = "frame", "scene_time"
BUILDINGS, CHANGES, LOG, SCORES, MISSED = "scene/buildings", "changes", "log", "scores", "missed"
SCENE = "scene"


def write(run: Run, path: Path) -> None:
    """Write the file: an entity for each estimate, named by its key expression, with a batch of boxes a frame."""
    stream = rerun.RecordingStream(APPLICATION, recording_id=run.id)
    stream.set_log_time_enabled(False)  # the time of the export
    stream.save(path, default_blueprint=blueprint(run))
    try:
        write_static(run, stream)
        for frame in frames_of(run):
            write_frame(run, frame, stream)
    finally:
        stream.disconnect()


def pose_entity(agent: str) -> str:
    """The entity with an agent's pose; only its camera and lidar are below it, as all else is in the world frame."""
    return f"agent/{agent}/pose"


def write_static(run: Run, stream: rerun.RecordingStream) -> None:
    """What does not change: axes, cameras, buildings, names of series."""
    stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for agent, camera in cameras(run).items():
        entity = f"{pose_entity(agent)}/camera"
        mount = rerun.Transform3D(translation=camera.mount_position, mat3x3=camera.mount_rotation)
        size = (camera.width, camera.height)
        stream.log(entity, mount, static=True)
        # x ahead, y left, z up, as the agent
        pinhole = rerun.Pinhole(focal_length=camera.focal, resolution=size, camera_xyz=rerun.ViewCoordinates.FLU)
        stream.log(entity, pinhole, static=True)
    if run.origin.any():
        x, y, _ = run.origin.tolist()
        stream.log(SCENE, rerun.TextDocument(f"Positions are relative to x {x:.0f} m, y {y:.0f} m."), static=True)
    if run.files.scene is not None:
        walls = rerun.LineStrips3D(list(wall_lines(run.files.scene) - run.origin), colors=[rgb(BUILDING_EDGE)])
        stream.log(BUILDINGS, walls, static=True)
    for series in run.scored:
        for name in ("fn", "fp", "rmse_m"):
            label = f"{series.agent} {series.estimator} {name}"
            stream.log(_score(series, name), rerun.SeriesLines(names=[label]), static=True)


def write_frame(run: Run, frame: Frame, stream: rerun.RecordingStream) -> None:
    """What a frame holds, at its time."""
    stream.set_time(FRAME, sequence=frame.index)
    stream.set_time(TIME, duration=np.timedelta64(frame.time_ns, "ns"))
    for agent, pose in frame.poses.items():
        place = rerun.Transform3D(translation=pose.position - run.origin, mat3x3=pose.rotation)
        stream.log(pose_entity(agent), place)
    for agent, scan in scans_in(frame).items():
        entity = f"{pose_entity(agent)}/lidar"
        stream.log(entity, rerun.Transform3D(translation=scan.position, mat3x3=scan.rotation))
        grey = np.clip(80.0 + 500.0 * scan.points.intensity, 0.0, 255.0).astype(np.uint8)
        stream.log(f"{entity}/points", rerun.Points3D(scan.points.position, colors=np.stack([grey] * 3, axis=1)))
    for series in run.topics:
        if series not in frame.objects:
            stream.log(run.topics[series], rerun.Clear(recursive=False))
            continue
        states = frame.objects[series]
        outcomes = frame.outcomes[series].names
        stream.log(run.topics[series], _boxes(states, run.origin, colours(frame, series), outcomes))
        if series != TRUTH:
            lost = missed(frame, series)
            colour = np.tile(rgb(OUTCOME_COLOURS["truth missed"]), (len(lost), 1))
            stream.log(f"{run.topics[series]}/{MISSED}", _boxes(lost, run.origin, colour, [MISSED] * len(lost)))
    changes = frame.changes
    places = np.where(np.isfinite(changes.after), changes.after, changes.before)
    shown = np.isfinite(places).all(axis=1) & (changes.role != "link")
    labels = [
        f"{effect} by {node}" for effect, node in zip(changes.effect[shown], changes.interposer[shown], strict=True)
    ]
    marks = rerun.Points3D(
        places[shown] - run.origin, colors=[rgb(ADVERSARY)], radii=[0.5], labels=labels, show_labels=False
    )
    stream.log(CHANGES, marks)
    for sentence in changes.sentences:
        stream.log(LOG, rerun.TextLog(sentence, level=rerun.TextLogLevel.WARN))
    for series, score in frame.scores.items():
        for name in ("fn", "fp", "rmse_m"):
            value = getattr(score, name)
            if not np.isnan(value):
                stream.log(_score(series, name), rerun.Scalars(value))


def _boxes(states: ObjectStates, origin: Floats, colour: Ints, outcomes: list[str]) -> rerun.Boxes3D:
    named = zip(class_names(states), states.id.tolist(), outcomes, strict=True)
    return rerun.Boxes3D(
        centers=states.position - origin,
        half_sizes=states.size / 2,
        quaternions=scalar_last_quaternions(states.yaw),
        colors=colour.astype(np.uint8),
        labels=[f"{kind} {number}, {outcome}" for kind, number, outcome in named],
        show_labels=False,
    )


def _score(series: Series, name: str) -> str:
    return f"{SCORES}/{series.agent}/{series.estimator}/{name}"


def blueprint(run: Run) -> views.Blueprint:
    """3D view and the main agent's camera with the truth, the picture and what it misses; two charts; the log."""
    shown = [topic for series, topic in run.topics.items() if series.estimator in (PICTURE, TRUTH.estimator)]
    shown += [f"{topic}/{MISSED}" for series, topic in run.topics.items() if series.estimator == PICTURE]
    contents = [f"+ /{entity}" for entity in (*shown, BUILDINGS, CHANGES)]
    contents += [f"+ /{pose_entity(agent)}/**" for agent in run.agents]
    charts = [
        views.TimeSeriesView(
            name=title,
            origin="/",
            contents=[f"+ /{_score(series, name)}" for series in run.scored if series.agent == run.agents[0]],
        )
        for title, name in (("false objects", "fp"), ("missed objects", "fn"))
    ]
    ground = list(rgb(GROUND))  # boxes of the truth are white
    camera = views.Spatial2DView(
        name=run.agents[0], origin=f"/{pose_entity(run.agents[0])}/camera", contents=contents, background=ground
    )
    return views.Blueprint(
        views.Horizontal(
            views.Spatial3DView(name="scene", origin="/", contents=contents, background=ground),
            views.Vertical(camera, *charts, views.TextLogView(name="changes", origin=f"/{LOG}")),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )
