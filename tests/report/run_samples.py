"""A small, consistent synthetic run: crossing, ego, poles, two adversaries."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from table_writing import write_table

from mast_zenoh.arrays.geometry import rotation_from_yaw, rotation_from_yaw_pitch
from mast_zenoh.arrays.states import Detections
from mast_zenoh.scenes.recording import Recording, SceneAgent, truth_states
from mast_zenoh.sensing.sensors import Camera, LidarSensor
from tests.support.wirings import wiring_of

FRAMES, ATTACK_START, EGO_ID = 40, 15, 100
AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
VICTIMS = {"adversary_1": "infra_1", "adversary_2": "infra_3"}


def crossing(frames: int = FRAMES) -> Recording:
    """Fourteen cars on two crossing roads; the ego comes from the west."""
    n = 14
    lane = np.arange(n) % 4
    yaw = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2])[lane]
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    lateral = np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    speed = np.where(lane % 2 == 0, 8.0, 3.0)
    start = ahead * (-70.0 + 22.0 * (np.arange(n) // 4))[:, None] + 3.0 * lateral
    times = np.arange(frames) * 100_000_000
    offset = ahead * speed[:, None]
    position = np.concatenate([np.column_stack([start + offset * t * 1e-9, np.full(n, 0.75)]) for t in times])
    ids = np.r_[EGO_ID, np.arange(1, n)]
    truth = truth_states(
        {
            "id": np.tile(ids, frames),
            "position": position,
            "velocity": np.tile(np.column_stack([offset, np.zeros(n)]), (frames, 1)),
            "size": np.tile([4.5, 1.8, 1.5], (n * frames, 1)),
            "yaw": np.tile(yaw, frames),
            "class_id": np.ones(n * frames, np.uint8),
        }
    )
    poles = np.array([[25.0, 25.0, 15.0], [-25.0, 25.0, 15.0], [-25.0, -25.0, 15.0], [25.0, -25.0, 15.0]])
    ego = position[::n] * [1, 1, 0]
    pole_rotations = [rotation_from_yaw_pitch(np.arctan2(-p[1], -p[0]), np.radians(30.0)) for p in poles]
    agents = [SceneAgent("ego", "mobile", EGO_ID, LidarSensor(), Camera())]
    agents += [SceneAgent(name, "static", -1, LidarSensor.infrastructure(), Camera()) for name in AGENTS[1:]]
    corners = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 55.0], [20.0, 55.0]])
    return Recording(
        name="crossing",
        agents=tuple(agents),
        period_ns=100_000_000,
        times_ns=times,
        truth=truth,
        truth_start=np.arange(frames + 1) * n,
        points=np.full((n * frames, len(AGENTS)), 10, np.int32),
        agent_position=np.stack([np.vstack([at, poles]) for at in ego]),
        agent_rotation=np.tile(np.stack([rotation_from_yaw(0.0), *pole_rotations]), (frames, 1, 1, 1)),
        agent_velocity=np.zeros((frames, len(AGENTS), 3)),
        detections=Detections.empty(),
        detection_start=np.zeros(frames * len(AGENTS) + 1, np.int64),
        detection_truth_id=np.zeros(0, np.int64),
        buildings=tuple(corners * [sx, sy] for sx in (1, -1) for sy in (1, -1)),
        building_height=np.array([12.0, 9.0, 15.0, 7.0]),
    )


def save_table(path: Path, rows: list[tuple[Any, ...]], names: str) -> None:
    """Write a table of `rows` with columns named by `names`, like the launcher."""
    columns = list(zip(*rows, strict=True)) if rows else [[] for _ in names.split()]
    write_table(path, dict(zip(names.split(), columns, strict=True)))


def changed(adversary: str, frame: int, effect: str) -> tuple[str | int, ...]:
    """The first columns of a row of attacks.parquet."""
    wire = f"agent/{VICTIMS[adversary]}/detections"
    return adversary, "adversary", wire, "detections", "", frame, effect


def score(recording: Recording, injected: dict[str, np.ndarray], rng: np.random.Generator) -> tuple[list, list, list]:
    """Rows of objects, counts and attacks; the ego's own sensor sees up to 45 m."""
    objects: list[tuple[Any, ...]] = []
    counts: list[tuple[Any, ...]] = []
    attacks: list[tuple[Any, ...]] = []
    nowhere = (np.nan, np.nan, np.nan)
    for frame in range(len(recording)):
        truth, ego = recording.truth_at(frame), recording.agent_position[frame, 0]
        near = np.hypot(*(truth.position - ego)[:, :2].T) < 45.0
        for estimator, seen in (("local", near), ("picture", rng.random(len(truth)) < 0.92)):
            tally = {"matched": 0, "missed": 0, "false": 0, "unevaluated": 0}

            def add(kind, outcome, id, match, at, yaw, by="", *, tally=tally, estimator=estimator, frame=frame):
                tally[outcome] += kind == "truth" or outcome == "false"
                cause = "inserted" if by else "fusion" if outcome == "missed" else ""
                box = (*at, 4.5, 1.8, 1.5, yaw, 0.9, cause, by)
                objects.append((frame, "ego", estimator, kind, outcome, id, match, *box))

            for i in range(len(truth)):
                if seen[i]:
                    add("truth", "matched", truth.id[i], truth.id[i] + 500, truth.position[i], truth.yaw[i])
                    at = truth.position[i] + rng.normal(0, 0.3, 3) * [1, 1, 0]
                    add("track", "matched", truth.id[i] + 500, truth.id[i], at, truth.yaw[i] + rng.normal(0, 0.05))
                else:
                    add("truth", "missed", truth.id[i], -1, truth.position[i], truth.yaw[i])
            if frame >= ATTACK_START:
                for adversary, starts in injected.items():
                    for k, at in enumerate(starts):
                        now = at + np.array([0.3, 0.1, 0.0]) * (frame - ATTACK_START)
                        if estimator == "picture":
                            add("track", "false", 900 + k, -1, now, 0.3 * k, adversary)
                            attacks.append((*changed(adversary, frame, "inserted"), *nowhere, *now))
                    if estimator == "picture":
                        removed = truth.position[5]
                        attacks.append((*changed(adversary, frame, "removed"), *removed, *nowhere))
            if frame % 9 == 0:
                add("truth", "unevaluated", 77, -1, (60.0, -3.0, 0.75), 0.0)
            counts.append(
                (
                    frame,
                    "ego",
                    estimator,
                    tally["missed"],
                    tally["false"],
                    tally["matched"],
                    0.4 if frame else np.nan,
                    int(frame == 20),
                )
            )
    return objects, counts, attacks


def summarise(counts: list[tuple[Any, ...]], attacks: list[tuple[Any, ...]]) -> dict[str, Any]:
    """metrics.json from counts and effects; adversaries caused all false objects."""
    ego: dict[str, Any] = {}
    for estimator in ("local", "picture"):
        counts_of_estimator = np.array([row[3:6] for row in counts if row[2] == estimator], np.float64)
        ego[estimator] = {
            name: {"mean": counts_of_estimator[:, i].mean(), "std": counts_of_estimator[:, i].std()}
            for i, name in enumerate(("fn", "fp", "tp"))
        } | {"rmse_m": 0.412, "id_switches": 1}
        errors = {"length_error_m": 0.2, "width_error_m": 1.0, "heading_error_deg": 2.0, "velocity_error_mps": 0.5}
        ego[estimator] |= {name: {"mean": mean, "std": 0.1} for name, mean in errors.items()}
        fn, fp, _ = counts_of_estimator.mean(axis=0)
        ego[estimator]["fn_split"] = {"fault": 0.0, "attack": 0.0, "natural": fn}
        ego[estimator]["fp_split"] = {"fault": 0.0, "attack": fp, "natural": 0.0}
    latency = {"sim_to_picture": {"p50": 2.13, "p99": 4.9}}
    interposers = {}
    for name, victim in VICTIMS.items():
        effects = Counter(row[6] for row in attacks if row[0] == name)
        if effects:
            summary = {"messages": FRAMES, "effects": dict(effects), "reports": effects.total(), "agreement": "agrees"}
            summary |= {"unreported": 0, "unfounded": 0}
            interposers[name] = {"role": "adversary", "wires": [f"agent/{victim}/detections"]} | summary
    return {
        "frames": FRAMES,
        "scored_frames": [0, FRAMES - 1],
        "agents": {"ego": ego | {"mission": ego["picture"]}},
        "same_as": {"ego": {"mission": "picture"}},
        "achieved": {},
        "driving": {},
        "interposers": interposers,
        "latency_ms": latency,
        "frames_per_second": 231.4,
    }


def wires(adversaries: dict[str, str], message: str) -> dict[str, Any]:
    """wiring.json of five agents with adversaries on `message` wires."""
    records: list[dict[str, Any]] = []
    shipped = wiring_of(AGENTS)
    known = {wire.key: {"subject": wire.subject, **wire.traits.to_json()} for wire in shipped.wires}

    def wire(key: str, kind: str, publisher: str, subscribers: list[str]) -> None:
        interposers = [a for a, victim in adversaries.items() if key == f"agent/{victim}/{message}"]
        chain = [publisher, *interposers]
        legs = [
            {
                "key": f"{key}/@tap/{i}" if i < len(chain) - 1 else key,
                "from": node,
                "from_port": key.rpartition("/")[2],
                "to": chain[i + 1 : i + 2] or subscribers,
                "to_ports": [kind for _ in chain[i + 1 : i + 2] or subscribers],
            }
            for i, node in enumerate(chain)
        ]
        records.append(
            {"subject": "", **known.get(key, {})}
            | {"key": key, "message": kind, "publisher": publisher, "subscribers": subscribers}
            | {"legs": legs, "interposers": interposers}
        )

    wire("clock", "clock", "simulator", [*AGENTS, "broker", "command_center", "evaluator"])
    wire("scene/truth", "truth", "simulator", ["evaluator"])
    for agent in AGENTS:
        wire(f"agent/{agent}/pose", "pose", "simulator", [agent])
        wire(f"agent/{agent}/detections", "detections", "simulator", [agent])
        wire(f"agent/{agent}/tracks", "tracks", agent, ["broker", "evaluator"])
        wire(f"agent/{agent}/mission", "tracks", agent, ["evaluator"])
    wire("cc/collated", "collated", "broker", ["command_center"])
    wire("cc/picture", "picture", "command_center", [*AGENTS, "evaluator"])
    for adversary in adversaries:
        wire(f"attack/{adversary}/report", "attack_report", adversary, ["evaluator"])
        if message == "tracks":
            wire(f"attack/{adversary}/observation", "observation", adversary, ["coordinator"])
            wire(f"attack/{adversary}/directive", "directive", "coordinator", [adversary])
    return {"wires": records, "nodes": shipped.to_json()["nodes"]}


def write_run(folder: Path, attack: str = "") -> Path:
    """Write a run folder; `attack` is "", "uncoordinated" or "coordinated"."""
    folder.mkdir(parents=True)
    (folder / "figures").mkdir()
    (folder / "logs").mkdir()
    recording, rng = crossing(), np.random.default_rng(7)
    adversaries = VICTIMS if attack else {}
    count = {"uncoordinated": 5, "coordinated": 2}.get(attack, 0)
    places = np.random.default_rng(8)
    injected = {name: np.c_[places.normal(0, 25, (count, 2)), np.full(count, 0.75)] for name in adversaries}
    objects, counts, attacks = score(recording, injected, rng)
    roles = dict.fromkeys(AGENTS, "agent") | dict.fromkeys(adversaries, "adversary")
    roles |= {name: name for name in ("simulator", "broker", "command_center", "evaluator")}
    if attack == "coordinated":
        roles["coordinator"] = "coordinator"
    run = {
        "id": f"{attack or 'baseline'}-1",
        "status": "ok",
        "seed": 3,
        "command": ["mast", "run", f"scenarios/{attack or 'baseline'}.py", "--set", "name=two words"],
        "versions": {"mast-zenoh": "0.1.0", "python": "3.11.7"},
        "timings": {"start_s": 1.2, "run_s": 0.9},
        "nodes": {
            name: {"role": role, "pid": 4000 + i, "exit": 0, "ended": "ok", "restarts": 0}
            for i, (name, role) in enumerate(roles.items())
        },
    }
    message = "tracks" if attack == "coordinated" else "detections"
    files = {"run": run, "scenario": {"seed": 3, "scene": {"type": "Crossing"}}, "metrics": summarise(counts, attacks)}
    for name, data in (files | {"wiring": wires(adversaries, message)}).items():
        (folder / f"{name}.json").write_text(json.dumps(data), "utf-8")
    recording.save(folder / "scene.npz")
    counts += [(*row[:2], "mission", *row[3:]) for row in counts if row[2] == "picture"]
    save_table(folder / "metrics.parquet", counts, "frame agent estimator fn fp tp rmse_m id_switches")
    save_table(
        folder / "objects.parquet",
        objects,
        "frame agent estimator kind outcome id match_id x y z l w h yaw score cause by",
    )
    if attack:
        names = "interposer role wire message before_subscriber frame effect"
        places = "before_x before_y before_z after_x after_y after_z"
        save_table(folder / "attacks.parquet", attacks, f"{names} {places}")
    return folder


def merged(old: Any, change: Any) -> Any:
    """`old` after a change: mappings are merged, an entry of `...` goes, a function is called, all else replaces."""
    if callable(change):
        return change(old)
    if not isinstance(change, dict) or not isinstance(old, dict):
        return change
    new = {name: merged(old.get(name), value) for name, value in change.items()}
    return {name: value for name, value in (old | new).items() if value is not ...}


def edit(folder: Path, **files: Any) -> Path:
    """Change the JSON files of a run, named without suffix: see `merged`; `...` removes a file, a text replaces it."""
    for name, change in files.items():
        path = folder / f"{name}.json"
        if change is ...:
            path.unlink()
        elif isinstance(change, str):
            path.write_text(change)
        else:
            path.write_text(json.dumps(merged(json.loads(path.read_text()), change)))
    return folder
