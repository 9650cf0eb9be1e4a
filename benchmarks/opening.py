"""How fast a long run opens, and in how much memory: only what is asked for is read.

    python benchmarks/opening.py [--run FOLDER] [--frames 10000] [--agents 100] [--repeats 5] [--cold]

Without --run it makes a run of so many frames and agents, of 1 GB, in two minutes. Each repeat is a new process, whose
imports are not counted. `s` is on the wall clock, `CPU` what the process used; both, and the largest resident memory
(VmHWM), are the medians at the end of each step. With --cold, the files are first dropped from the page cache.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from long_run import sparse

#: What is done one after the other, each with `path`, of the folder, and `frame`.
STEPS = {
    "imports": "import mast_zenoh as mast; mast.open; from mast_zenoh.runs.frame import frame_at",
    "open": "run = mast.open(path); run.record, run.name, run.agents, run.summary, run.ego",
    "boxes of a frame": "frame_at(run, frame, ['picture']).boxes",
    "boxes of the next frame": "frame_at(run, frame + 1, ['picture']).boxes",
    "a frame of the scene": "scene = run.files.scene; scene.truth_at(frame); scene.agent_position[frame]; "
    "scene.detections_at(frame, 0)",
    "scores of a window": "run.within(frame, frame + 200).counts_of('picture')",
}
#: Does the steps, and prints for each: wall time and processor time in s, memory in MB.
PROGRAM = """
import json, re, sys, time
from pathlib import Path
path, frame = Path(sys.argv[1]), int(sys.argv[2])
for name, step in json.loads(sys.argv[3]).items():
    began = time.perf_counter(), time.process_time()
    exec(step)
    took = time.perf_counter() - began[0], time.process_time() - began[1]
    peak = int(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1e3
    print(json.dumps([name, *took, peak]))
"""


def drop_from_cache(folder: Path) -> None:
    """Have the files of a folder read from the disk the next time."""
    os.sync()
    for path in folder.iterdir():
        if path.is_file():
            with path.open("rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def measure(folder: Path, frame: int) -> dict[str, tuple[float, ...]]:
    """Wall time, processor time and memory by step, in a new process."""
    command = [sys.executable, "-c", PROGRAM, str(folder), str(frame), json.dumps(STEPS)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return {name: tuple(numbers) for name, *numbers in map(json.loads, output.splitlines())}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--agents", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = arguments.run or sparse(Path(place) / "run", arguments.frames, arguments.agents)
        frame = json.loads((folder / "metrics.json").read_text())["frames"] // 2
        size = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
        repeats = []
        for _ in range(arguments.repeats):
            if arguments.cold:
                drop_from_cache(folder)
            repeats.append(measure(folder, frame))
    print(f"{size / 1e6:.0f} MB; load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    print(f"{'':26}{'s':>8}{'CPU':>8}{'MB':>8}")
    for name in STEPS:
        wall, processor, peak = (statistics.median(repeat[name][place] for repeat in repeats) for place in range(3))
        print(f"{name:26}{wall:8.3f}{processor:8.3f}{peak:8.0f}")


if __name__ == "__main__":
    main()
