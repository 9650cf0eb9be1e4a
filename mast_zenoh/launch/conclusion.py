"""Writes the results and notices of a run that is over."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh import run_folder
from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import DETECTION_COLUMNS, Detections
from mast_zenoh.config.resolved import RECORDING, NodeSpec, Resolved, driver_of
from mast_zenoh.errors import MessageError, RunFolderError, SceneError
from mast_zenoh.launch import idle, notices
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.results import EVALUATOR, EXPECTED_NAME, MAX_TABLES, counts_of, is_table_name
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.run_folder import subfolder
from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.run_folder.recording.reader import first_incomplete_frame, first_missing_frame, read
from mast_zenoh.scenes.recording import TRUTH_COLUMNS, Recording, truth_states
from mast_zenoh.wiring.model import Wiring, subject_of

_MAX_PROBLEM_CHARS = 300  # of a problem as a node describes it

#: Arrival of the first message of each frame, by key and frame, ns; and time at which each frame was sent, ns.
Arrivals = Mapping[str, Mapping[int, int]]
Sent = Mapping[int, int]

PERCENTILES = (50, 95, 99)


def latency_ms(wiring: Wiring, outcomes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The `latency_ms` of metrics.json: from simulator to picture, and of every wire.

    outcomes: what each node has handed in

    A picture has come when the first node has it that receives it as it was sent, because others, such as the
    evaluator, may be busy.

    Keys:
    sim_to_picture: `p50`, `p95`, `p99`, ms, and number `n` of frames
    by_wire: by key of a wire, the same
    """
    sent, arrived = on_launcher_clock(outcomes)
    common = wiring.find(estimate=PICTURE)
    key = common.legs[0].key if common else ""
    of_nodes = [arrivals.get(key, {}) for arrivals in arrived.values()]
    frames = set().union(*of_nodes)
    picture = percentiles(sent, {frame: min(at[frame] for at in of_nodes if frame in at) for frame in frames})
    to_picture = picture or dict.fromkeys(f"p{p}" for p in PERCENTILES)
    return {"sim_to_picture": to_picture, "by_wire": by_wire(wiring, sent, arrived)}


def by_wire(wiring: Wiring, sent_ns: Sent, arrived_ns: Mapping[str, Arrivals]) -> dict[str, dict[str, float | int]]:
    """Percentiles in ms and number of frames of every wire that carried messages.

    sent_ns: when the simulator sent each frame; arrived_ns: arrivals at each node

    Of a wire's subscribers, the first that publishes something itself counts, because others wait for it; if none of
    those received anything, the first of the others. Interposers and nodes that overhear every key do not count.
    """
    publishers = {leg.publisher.node for _, leg in wiring.legs()}
    latencies: dict[str, dict[str, float | int]] = {}
    for wire in wiring.wires:
        key_of = {end: leg.key for leg in wire.every_leg for end in leg.subscribers}
        for end in sorted(wire.subscribers, key=lambda end: end.node not in publishers):
            if wire_latency := percentiles(sent_ns, arrived_ns.get(end.node, {}).get(key_of[end], {})):
                latencies[wire.key] = wire_latency
                break
    return latencies


def percentiles(sent_ns: Sent, arrival_ns: Mapping[int, int]) -> dict[str, float | int]:
    """Percentiles in ms from sending to arrival, and number of frames that arrived."""
    latency = [(arrival_ns[frame] - sent_ns[frame]) * 1e-6 for frame in arrival_ns if frame in sent_ns]
    if not latency:
        return {}
    return {f"p{p}": round(float(np.percentile(latency, p)), 3) for p in PERCENTILES} | {"n": len(latency)}


def on_launcher_clock(outcomes: Mapping[str, Mapping[str, Any]]) -> tuple[Sent, dict[str, Arrivals]]:
    """Times at which frames were sent and arrived, on the launcher's clock, ns.

    outcomes: what each node has handed in; a node on another host has `clock`, how far its clock is ahead
    """
    sent: Sent = {}
    arrived: dict[str, Arrivals] = {}
    for name, outcome in outcomes.items():
        ahead_ns = round(outcome.get("clock", {}).get("offset_ms", 0.0) * 1e6)
        arrivals = outcome.get("arrived_ns", {})
        arrived[name] = {key: {frame: at - ahead_ns for frame, at in times.items()} for key, times in arrivals.items()}
        if "sent_ns" in outcome:
            sent = {frame: at - ahead_ns for frame, at in outcome["sent_ns"].items()}
    return sent, arrived


def write(
    resolved: Resolved,
    folder: Path,
    record: dict[str, Any],
    handed_in: Mapping[str, Mapping[str, Any]],
    measured: Mapping[str, Any],
    tables: TableFiles,
) -> None:
    """Write the results of all nodes into the run folder, and add notices to `record`.

    record:    run.json, with its nodes and timings
    handed_in: what each node returned from `finish`
    measured:  see `write_results`
    tables:    those that nodes have handed in part by part
    """
    note_recording(folder, record, handed_in, resolved.nodes)
    collations = results.collations(handed_in, resolved.nodes)
    innovations = notices.tracker_innovations(handed_in, resolved.nodes)
    record["innovations"] = dict(sorted(innovations.items()))
    measured = {"late": results.late(collations), **measured}
    if "replay" in record:
        measured["replay"] = {key: value for key, value in record["replay"].items() if key != "notices"}
    refused = write_results(folder, handed_in, measured, tables)
    if outside := results.outside(handed_in, resolved.nodes):
        record["outside"] = outside
    found = [*notices.of_run(resolved, record, collations, measured, refused, results.left_out(handed_in))]
    if problem := write_driven_scene(folder, resolved):
        found.append(Finding("scene", cause=(problem,)))
    world, wiring = driver_of(resolved.nodes), Wiring.from_json(resolved.wiring)
    rejected = counts_of(record["nodes"].get(world, {}).get("rejected"))
    found += notices.of_commands(handed_in.get(world, {}).get("commands"), wiring, rejected)
    played = record["timings"].get("frames")
    metrics = handed_in.get(results.EVALUATOR, {}).get("metrics")
    if isinstance(metrics, Mapping):
        found += notices.of_scores(metrics, played)
        found += notices.of_estimates(metrics.get("driven"), metrics.get("frames"))
        found += notices.of_brakes(metrics.get("driven"))
        found += notices.of_confidence(metrics, innovations)
    found += idle.idle_parts(resolved, played or 0, handed_in, folder, replayed="replay" in record)
    record["notices"] = [each.to_json() | {"text": sentence(each)} for each in found]


def write_results(
    folder: Path, results: Mapping[str, Mapping[str, Any]], measured: Mapping[str, Any], handed_in: TableFiles
) -> list[str]:
    """Write what nodes returned from `finish`; return a sentence per refused part.

    The evaluator's `metrics`, and those of its `tables` that are in `results.TABLES`, become metrics.json and Parquet
    files at the top of the run folder. Everything else goes to results/<node>/: tables as <table>.parquet, the rest as
    results.json. Tables that come in parts are written by `TableFiles`.

    results:  of each node; `tables` are sentences about those that it could not hand in, see `PartedTables.close`
    measured: entries of metrics.json in addition to the evaluator's metrics; wall-clock values replace the evaluator's
    handed_in: the tables that nodes have handed in part by part, which are written already
    """
    refused = [f"{node}: table {table}: {problem}" for (node, table), problem in handed_in.refused.items()]
    lost = dict.fromkeys(sorted({node for node, _ in handed_in.written} - results.keys()), "it was lost before the end")
    refused += [f"{node}: its tables are incomplete: {why:.200}" for node, why in (lost | handed_in.incomplete).items()]
    for node, result in results.items():
        other_parts = dict(result)
        tables = other_parts.pop("tables", {})
        if not is_table_name(node):
            refused.append(f"{node!r:.80}: {EXPECTED_NAME}")
            continue
        if node == EVALUATOR and isinstance(other_parts.get("metrics"), Mapping):
            run_folder.write_json(
                folder / "metrics.json", run_folder.finite({**other_parts.pop("metrics"), **measured})
            )
        if not isinstance(tables, Mapping):
            refused.append(f"{node}: tables: found a {type(tables).__name__}, expected a dict of tables")
            tables = {}
        shown = [text for text in tables.values() if isinstance(text, str) and text.isprintable()][:MAX_TABLES]
        refused += [f"{node}: {text:.300}" for text in shown]
        if len(tables) > len(shown):
            refused.append(f"{node}: tables: {len(tables) - len(shown)} more are refused")
        if other_parts:
            run_folder.write_json(subfolder(folder, "results", node) / "results.json", run_folder.finite(other_parts))
    if handed_in.problem is not None:
        raise handed_in.problem
    return refused


def note_recording(
    folder: Path, record: dict[str, Any], handed_in: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, NodeSpec]
) -> None:
    """Note in run.json how many messages were recorded, and whether some are missing.

    Only recorders know the number. The first frame with missing messages is measured from the recording in `folder`:
    in real time always, because the router drops messages for a recorder that does not read; in lock-step nodes wait.
    """
    recorder = next((name for name, spec in nodes.items() if spec.role == "recorder"), None)
    if recorder is not None:
        gaps = churn.first_frames(record.get("churn", ()), recorder)
        lost = counts_of(handed_in.get(recorder, {}).get("recorded")).get("lost")
        driver = driver_of(nodes)
        if record.get("mode") == "realtime" and driver:
            gap = first_missing_frame(folder, driver, scans=bool(nodes[recorder].config.get("points")))
            gaps += [] if gap is None else [gap]
        complete = recorder in handed_in and not lost and not gaps
        from_frame = {} if complete else {"from_frame": min([first_incomplete_frame(folder), *gaps])}
        record["recording"] = {"complete": complete} | from_frame
    for node, outcome in handed_in.items():
        if node in nodes and nodes[node].role == "recorder" and (recorded := counts_of(outcome.get("recorded"))):
            record["recorded"] = recorded | _failure(outcome["recorded"])
            if lost := recorded.get("lost", 0):
                messages = [record["message"]] if record["message"] else []
                record["message"] = "; ".join([*messages, f"{lost} messages could not be recorded"])


def _failure(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Why a recorder stopped, if it did, and whether the disk was full."""
    problem = recorded.get("problem")
    if not isinstance(problem, str) or not problem:
        return {}
    return {"problem": problem[:_MAX_PROBLEM_CHARS], "disk_full": recorded.get("disk_full") is True}


def rates(frames: int, wall_s: float) -> dict[str, Any]:
    """Duration and speed of a run, for its `timings`.

    Keys:
    frames: number of frames that were played
    start_s, run_s, total_s: until the first frame; from there to the last one; in all
    frames_per_second: while it ran
    """
    return {
        "frames": frames,
        "run_s": round(wall_s, 4),
        "frames_per_second": round(frames / wall_s, 2) if wall_s else None,
    }


# -- the scene of a run whose cars were driven, as it happened: in place of the prepared one, for what shows the run ---

#: Types of the messages of which a scene is made.
_SCENE_TYPES = ("truth", "pose", "detections", "sweep")
#: Such messages by type and subject, as they are published: bodies by frame.
_SceneMessages = Mapping[tuple[str, str], Mapping[int, Body]]


def write_driven_scene(folder: Path, resolved: Resolved) -> str:
    """Write the scene as it happened into a run folder whose cars were driven; returns why not, or "".

    It is made of the recorded messages of the simulator, so of no run without a recording.
    """
    if all(spec.role != "driver" for spec in resolved.nodes.values()):
        return ""
    try:
        prepared = resolved.recording or Recording.load(folder / RECORDING)
        happened = _driven_recording(prepared, _scene_messages(folder, resolved))
        happened.validate()
        unfinished = folder / f".{RECORDING}"
        happened.save(unfinished)
        unfinished.replace(folder / RECORDING)
    except (RunFolderError, MessageError, SceneError, ValueError, KeyError) as error:  # of a world of the user's own
        return f"figures, films and views of this run show its prepared scene, in which nobody drives: {error}"
    return ""


def _scene_messages(folder: Path, resolved: Resolved) -> _SceneMessages:
    """What the simulator sent, and what was detected in its points."""
    of_scene = [wire for wire in Wiring.from_json(resolved.wiring).wires if wire.message in _SCENE_TYPES]
    keys = {wire.legs[0].key: (wire.message, wire.subject) for wire in of_scene}
    wires = {wire.key for wire in of_scene}
    sent: dict[tuple[str, str], dict[int, Body]] = defaultdict(dict)
    for message in read(folder, lambda channel: channel.get("wire") in wires):
        if message.key in keys:  # not what interposers forward
            body = codec.decode(message.payload, message.message).body
            sent[keys[message.key]].setdefault(message.frame, body)
    return sent


def _driven_recording(prepared: Recording, sent: _SceneMessages) -> Recording:
    """The prepared scene with the truth, poses and detections that were sent; the frames that are whole."""
    agents = [agent.name for agent in prepared.agents]
    sensors = [
        subject_of(agent.name, sensor.name if row else "")
        for agent in prepared.agents
        for row, sensor in enumerate(agent.sensors)
    ]
    sensors_sent = [name for name in sensors if ("detections", name) in sent]  # agents may detect objects themselves
    wires = [("truth", ""), *(("pose", name) for name in agents), *(("detections", name) for name in sensors_sent)]
    whole = set.intersection(*(set(sent.get(wire, {})) for wire in wires))
    frames = range(next((k for k in range(len(prepared)) if k not in whole), len(prepared)))
    if not frames:
        raise SceneError("no frame is whole in its recording")

    def of(port: str, name: str, subjects: list[str]) -> np.ndarray:
        return np.array([[sent[port, subject][k][name] for subject in subjects] for k in frames])

    truth = [sent["truth", ""][k] for k in frames]
    nothing = Detections.empty().columns()
    detected = [sent.get(("detections", name), {}).get(k, nothing) for k in frames for name in sensors]
    swept = [("sweep", name) for name in agents]
    sweeps: tuple[Any, ...] = ()
    if all(set(frames) <= sent.get(wire, {}).keys() for wire in swept):
        sweeps = tuple(np.array([sent[wire][k]["free"] for k in frames], np.float32) for wire in swept)
    detections = {name: np.concatenate([body[name] for body in detected]) for name in DETECTION_COLUMNS}
    return replace(
        prepared,
        times_ns=prepared.times_ns[: len(frames)],
        truth=truth_states({name: np.concatenate([body[name] for body in truth]) for name in TRUTH_COLUMNS}),
        truth_start=np.cumsum([0, *(len(body["id"]) for body in truth)]),
        points=np.concatenate([body["points"] for body in truth]),
        agent_position=of("pose", "position", agents),
        agent_rotation=rotation_from_quaternion(of("pose", "rotation", agents)),
        agent_velocity=of("pose", "velocity", agents),
        detections=Detections(*(detections[name] for name in DETECTION_COLUMNS)),
        detection_start=np.cumsum([0, *(len(body["score"]) for body in detected)]),
        detection_truth_id=np.full(len(detections["score"]), -1, np.int64),  # nobody says of what they are
        sweeps=sweeps,
    )
