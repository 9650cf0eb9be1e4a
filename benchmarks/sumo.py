"""Time of a frame of SUMO's traffic with driven cars, in parts.

    python benchmarks/sumo.py CONFIGURATION.sumocfg [--cars 20] [--start 400] [--scale 1] [--frames 100] [--json FILE]

| line | what is measured |
|---|---|
| routes | what the map, the lights and the right of way tell the drivers |
| step | the cars' motion, and SUMO, in its own process: wall time |
| truth | objects around the agents |
| lidars | what the lidar of every driven car sees, without buildings |
| detectors | what their detectors report |

Drivers brake for lines and otherwise keep their speed. The median of the frames is printed, as other processes only add
time, and at last how much faster than real time a frame of 0.1 s is, and with processor time alone.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections import defaultdict
from pathlib import Path

import psutil
from mast_datasets import SumoTraffic

from mast_zenoh.driving.motion import Command
from mast_zenoh.scenes.making.observe import FrameDetection, lidar_visibility

PERIOD_S = 0.1


def processor_s() -> float:
    """Processor time of this process and of SUMO's."""
    processes = [psutil.Process(), *psutil.Process().children()]
    return sum(times.user + times.system for times in (process.cpu_times() for process in processes))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("configuration")
    parser.add_argument("--cars", type=int, default=20)
    parser.add_argument("--start", type=float, default=400.0)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--json", type=Path, help="file for ms of each frame")
    options = parser.parse_args()
    scene = SumoTraffic(
        path=options.configuration,
        n_mobile=options.cars - 1,
        n_infrastructure=0,
        start_s=options.start,
        scale=options.scale,
    )
    world = scene.world(0, options.frames)
    present = world.now()
    detection = FrameDetection(present, world.detector, 0)
    times: dict[str, list[float]] = defaultdict(list)
    begin_s = processor_s()
    for frame in range(options.frames):
        marks = [time.perf_counter()]
        routes = {car: world.route(car) for car in world.cars}
        marks.append(time.perf_counter())
        world.step({car: Command(-2.0 if route.stop_m < 30.0 else 0.0, 0.0) for car, route in routes.items()})
        marks.append(time.perf_counter())
        present = world.now()
        marks.append(time.perf_counter())
        points = lidar_visibility(present, walls=detection.walls)
        marks.append(time.perf_counter())
        for _ in detection.of(present, 0, points, number=frame):
            pass
        marks.append(time.perf_counter())
        for name, start, end in zip(
            ("routes", "step", "truth", "lidars", "detectors"), marks[:-1], marks[1:], strict=True
        ):
            times[name].append(end - start)
    if options.json:
        named = {f"{name} (ms)": [1000 * each for each in seconds] for name, seconds in times.items()}
        named["frame (ms)"] = [sum(parts) for parts in zip(*named.values(), strict=True)]
        options.json.write_text(json.dumps(named), "utf-8")
    processor_ms = 1000 * (processor_s() - begin_s) / options.frames
    world.close()
    print(f"{options.cars} driven cars, {len(present.truth)} objects around them")
    for name, seconds in times.items():
        print(f"{name:10} {1000 * statistics.median(seconds):8.2f} ms")
    total_s = sum(statistics.median(seconds) for seconds in times.values())
    print(f"{'frame':10} {1000 * total_s:8.2f} ms: {PERIOD_S / total_s:.1f} times real time")
    print(f"processor time, of SUMO too: {processor_ms:.2f} ms: {1000 * PERIOD_S / processor_ms:.1f} times real time")


if __name__ == "__main__":
    main()
