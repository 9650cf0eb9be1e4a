"""Finds the files of a scenario.

<scenario>/<agent>/<frame>.yaml                       agent: a number, below 0 for poles
<scenario>/{cav,rsu}_<agent>/<frame>.yaml, <frame>_view.yaml; <scenario>/map/<frame>.yaml         Multi-V2X
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mast_zenoh.errors import ConfigurationError, SceneError

_AGENT = re.compile(r"(?:(cav|rsu)_)?(-?[0-9]{1,9})")
_FRAME = re.compile(r"([0-9]{1,9})\.yaml")
_VIEW = re.compile(r"([0-9]{1,9})_view\.yaml")
_MAX_AGENTS = 1000
_MAX_FRAMES = 100_000


@dataclass(frozen=True)
class AgentFolder:
    """The folder of an agent.

    number: of the agent; is_pole: whether it is infrastructure
    files: the file of each frame, ascending; views: those of what it sees, {} without any
    """

    folder: Path
    number: int
    is_pole: bool
    files: dict[int, Path]
    views: dict[int, Path]

    def file(self, frame: int) -> Path:
        """The file of a frame. Raises SceneError if there is none."""
        return _file(self.folder, self.files, frame, "")

    def view(self, frame: int) -> Path:
        """The file of what the agent sees in a frame. Raises SceneError if there is none."""
        return _file(self.folder, self.views, frame, "_view")

    def covers(self, frames: Sequence[int]) -> bool:
        """Whether the agent is there from the first to the last of the frames."""
        return bool(self.files) and min(self.files) <= frames[0] and frames[-1] <= max(self.files)


def find_scenario(path: Path) -> tuple[Path, list[AgentFolder]]:
    """The folder of the scenario at `path`, and its agents by number, cars first.

    path: the scenario's folder, or a folder that holds a single one
    """
    if not path.is_dir():
        raise SceneError(f"{path}: no such folder")
    candidates = [path, *sorted(child for child in _children(path) if child.is_dir())]
    scenarios = [folder for folder in candidates if any(map(_is_agent, _children(folder)))]
    # The agents of the scenario itself have files, no agents.
    if len(scenarios) != 1:
        raise SceneError(
            f"{path}: {len(scenarios)} scenarios, expected one: a folder of agents' folders with files <frame>.yaml"
        )
    folder = scenarios[0]
    agents = [_agent(child) for child in sorted(_children(folder)) if _is_agent(child)]
    if len(agents) > _MAX_AGENTS:
        raise SceneError(f"{folder}: found {len(agents)} agents, expected at most {_MAX_AGENTS}")
    agents.sort(key=lambda agent: (agent.is_pole, abs(agent.number)))
    for one, other in itertools.pairwise(sorted(agents, key=lambda agent: (agent.is_pole, agent.number))):
        if one.number == other.number:
            raise SceneError(f"{other.folder}: found agent {other.number} twice, also {one.folder.name}")
    return folder, agents


def map_files(folder: Path) -> dict[int, Path]:
    """The files of all objects of a scenario (Multi-V2X), by frame."""
    files = _frames(folder / "map", _FRAME) if (folder / "map").is_dir() else {}
    if not files:
        raise SceneError(f"{folder / 'map'}: no files <frame>.yaml, expected one with all objects of each frame")
    return files


def map_file(folder: Path, files: dict[int, Path], frame: int) -> Path:
    """The file of all objects in a frame. Raises SceneError if there is none."""
    return _file(folder / "map", files, frame, "")


def choose_frames(agent: AgentFolder, first: int | None, last: int | None) -> list[int]:
    """The frames of the ego from `first` to `last`, the same step apart; None: without that limit.

    Raises SceneError for a gap, and ConfigurationError for a limit that is no frame.
    """
    numbers = list(agent.files)
    for name, limit in (("first_frame", first), ("last_frame", last)):
        if limit is not None and limit not in agent.files:
            raise ConfigurationError(
                f"{agent.folder}: {name} is {limit}, expected the number of one of its files, "
                f"{numbers[0]} to {numbers[-1]}"
            )
    chosen = [n for n in numbers if (first is None or n >= first) and (last is None or n <= last)]
    if not chosen:
        raise ConfigurationError(f"{agent.folder}: first_frame is {first}, expected at most last_frame, {last}")
    step = min((after - before for before, after in itertools.pairwise(chosen)), default=1)
    for before, after in itertools.pairwise(chosen):
        if after - before != step:
            raise SceneError(
                f"{agent.folder}: frame {before} is followed by {after}, expected {before + step}; "
                "first_frame and last_frame choose a part without a gap"
            )
    return chosen


def check_frames(agents: Sequence[AgentFolder], frames: Sequence[int]) -> None:
    """Raise SceneError for the first agent that has other frames than the ego."""
    for agent in agents:
        for frame in frames:
            agent.file(frame)
        between = [frame for frame in agent.files if frames[0] <= frame <= frames[-1]]
        extra = sorted(set(between) - set(frames))
        if extra:
            raise SceneError(f"{agent.files[extra[0]]}: the ego has no frame {extra[0]}, expected the same frames")


def _children(folder: Path) -> list[Path]:
    try:
        return [Path(entry.path) for entry in os.scandir(folder) if not entry.name.startswith(".")]
    except OSError as error:
        raise SceneError(f"{folder}: {error}") from error


def _is_agent(folder: Path) -> bool:
    return (
        bool(_AGENT.fullmatch(folder.name))
        and folder.is_dir()
        and any(_FRAME.fullmatch(child.name) for child in _children(folder))
    )


def _agent(folder: Path) -> AgentFolder:
    match = _AGENT.fullmatch(folder.name)
    kind, number = (match[1], int(match[2])) if match else ("", 0)
    return AgentFolder(folder, number, kind == "rsu" or number < 0, _frames(folder, _FRAME), _frames(folder, _VIEW))


def _frames(folder: Path, pattern: re.Pattern[str]) -> dict[int, Path]:
    """Files by the number in their names, ascending."""
    files: dict[int, Path] = {}
    for path in sorted(_children(folder)):
        match = pattern.fullmatch(path.name)
        if match is None:
            continue
        frame = int(match[1])
        if frame in files:
            raise SceneError(f"{path}: found frame {frame} twice, also {files[frame].name}")
        files[frame] = path
    if len(files) > _MAX_FRAMES:
        raise SceneError(f"{folder}: found {len(files)} frames, expected at most {_MAX_FRAMES}")
    return dict(sorted(files.items()))


def _file(folder: Path, files: dict[int, Path], frame: int, ending: str) -> Path:
    if frame not in files:
        raise SceneError(
            f"{folder}: no file for frame {frame}, expected {frame:06d}{ending}.yaml: "
            "agents that appear or disappear cannot be played"
            if not ending
            else f"{folder}: no file for frame {frame}, expected {frame:06d}{ending}.yaml"
        )
    return files[frame]
