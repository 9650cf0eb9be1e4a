"""A faulted run in the tiny world, and copies of its record with planted errors."""

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from tiny_world import TinyScene

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import checks, run
from mast_zenoh.launch.checks import Check
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import text
from mast_zenoh.run_folder.recording.reader import Recorded, read
from mast_zenoh.run_folder.recording.writer import FILE, MessageLog
from mast_zenoh.scenario import resolve
from mast_zenoh.wiring.model import Wiring

FRAMES = 50
FAULTS = [
    dict(type="Partition", at=0.5, until=1.0, nodes=["infra_1"]),
    dict(type="Kill", at=1.2, node="infra_2", restart_after=0.3),
    dict(type="Flood", at=1.0, until=1.4, node="ego", copies=2),
    dict(type="Delay", at=1.6, until=2.0, node="ego", mean_s=0.2, jitter_s=0.05),
    dict(type="Corrupt", at=1.6, until=2.0, node="infra_1", probability=0.7, flips=50),
    dict(type="Corrupt", at=1.6, until=2.0, node="infra_2", probability=1.0),
]


def scenario(**keys: Any) -> tuple[Path, dict[str, Any]]:
    """(file, dict) of the baseline in the tiny world, with additional keys."""
    from mast_zenoh import scenario as scenarios

    path, content = scenarios.load("baseline", ["n_infrastructure=2"])
    return path, {**content, "scene": dict(type=TinyScene.__name__, n_infrastructure=2), **keys}


def recorded(out: Path, *, frames: int = FRAMES, record: bool = True, **keys: Any) -> tuple[Path, Resolved]:
    """Run in one process; returns the folder and the resolved scenario."""
    path, content = scenario(**keys)
    resolved = resolve(path, content, frames=frames, record=record)
    outcome = run.run(resolved, out, runtime="inproc")
    assert outcome.error is None
    assert not any(node["failures"] for node in outcome.record["nodes"].values())
    return outcome.folder, resolved


def rewritten(
    folder: Path, resolved: Resolved, out: Path, change: Callable[[Recorded], Iterable[bytes | None]]
) -> Path:
    """Copy a run folder, replacing each message by the result of `change`."""
    copy = shutil.copytree(folder, out)
    (copy / FILE).unlink()
    log = MessageLog(copy / FILE)
    log.begin(Wiring.from_json(resolved.wiring).ports("recorder").inputs)
    for message in read(folder):
        if message.malformed:
            log.add_malformed(
                message.key.removesuffix("/@malformed"), message.payload, 0, message.time_ns, message.step
            )
            continue
        for payload in change(message):
            kept = message.payload if payload is None else payload
            log.add(message.key, kept, codec.decode_header(kept, message.message), message.step)
    log.close()
    return copy


def lost(*targets: tuple[str, int]) -> Callable[[Recorded], Iterable[None]]:
    """Remove the messages of these keys and frames."""
    return lambda message: [] if (message.key, message.frame) in targets else [None]


def doubled(*targets: tuple[str, int]) -> Callable[[Recorded], Iterable[None]]:
    """Duplicate messages in the record."""
    return lambda message: [None, None] if (message.key, message.frame) in targets else [None]


def changed(
    key: str, change: Callable[[int, dict[str, Any]], dict[str, Any] | None]
) -> Callable[[Recorded], Iterable[bytes | None]]:
    """Replace the columns of messages on a key; None keeps the message."""

    def apply(message: Recorded) -> Iterable[bytes | None]:
        if message.key != key:
            return [None]
        decoded = codec.decode(message.payload, message.message)
        body = change(message.frame, dict(decoded.body))
        return [None if body is None else codec.encode(codec.conform(decoded.header, body))]

    return apply


def without_agent(body: dict[str, Any], name: str) -> dict[str, Any]:
    """Remove an agent's tracks from a collation."""
    names = list(body["agents"])
    index = names.index(name)
    rows = body["agent"] != index
    columns = {key: column[rows] for key, column in body.items() if key not in ("agents", "age_ns")}
    columns["agent"] = columns["agent"] - (columns["agent"] > index)
    return columns | {"agents": text([n for n in names if n != name]), "age_ns": np.delete(body["age_ns"], index)}


def without_row(body: dict[str, Any]) -> dict[str, Any]:
    """Remove the first track of a collation."""
    return {key: column if key in ("agents", "age_ns") else column[1:] for key, column in body.items()}


def checked(folder: Path, resolved: Resolved) -> dict[str, Check]:
    """The checks of a run, by name."""
    return {check.name: check for check in checks.run(folder, resolved)}
