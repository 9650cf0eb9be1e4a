"""Files of JSON lines, with one line for each frame of each agent."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from mast_zenoh.errors import SceneError


def lines_of_agents(
    path: Path, frames: Sequence[int], agents: Sequence[int] | Sequence[str], key: str
) -> Iterator[tuple[str, int, int, list[Any]]]:
    """Yield the list under `key` for the requested frames and agents.

    Each comes with its position in the file, frame row and agent row. agents: as they are called in the file.
    Raises SceneError if a frame of an agent occurs twice or not at all.
    """
    frame_row = {frame: k for k, frame in enumerate(frames)}
    agent_row = {agent: k for k, agent in enumerate(agents)}
    named = any(isinstance(agent, str) for agent in agents)
    line_numbers: dict[tuple[int, int | str], int] = {}
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                place = f"{path}: line {number}"
                try:
                    data = json.loads(line, parse_constant=reject_constant)
                    frame_agent = (int(data["frame"]), str(data["agent"]) if named else int(data["agent"]))
                    entries = data[key]
                    if not isinstance(entries, list):
                        raise ValueError(f"{key} is not a list")
                except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
                    raise SceneError(f"{place}: {reason(error)}") from error
                if frame_agent in line_numbers:
                    raise SceneError(
                        f"{place}: frame {frame_agent[0]} of agent {frame_agent[1]} "
                        f"is already in line {line_numbers[frame_agent]}"
                    )
                line_numbers[frame_agent] = number
                if frame_agent[0] in frame_row and frame_agent[1] in agent_row:
                    yield place, frame_row[frame_agent[0]], agent_row[frame_agent[1]], entries
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: {error}") from error
    for frame in frames:
        for agent in agents:
            if (frame, agent) not in line_numbers:
                raise SceneError(
                    f"{path}: no line for frame {frame}, agent {agent}; use an empty list if nothing was detected"
                )


def reject_constant(name: str) -> NoReturn:
    """Refuse a number that is not finite, for `json.loads(parse_constant=)`."""
    raise ValueError(f"{name} is not a finite number")


def reason(error: Exception) -> str:
    """Why decoding failed, in words."""
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)
