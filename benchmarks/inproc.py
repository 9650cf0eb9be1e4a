"""Frames/s of whole runs in one process, and the speed-up by a second job.

Runs include all roles and the evaluation.

    python benchmarks/inproc.py [--scene avstack:PATH] [--repeats 7] [--trials 140] [--rounds 3]

Runs are timed from building the nodes to the evaluator's results, in CPU time of one core (without other work on the
machine) and on the wall clock. The best repetition shows what the code can do, the median a typical run.

Jobs are compared by trials per second of wall clock: for all trials with the start of the workers, and without it (from
the first outcomes to the last), as in a study of many trials. Runs alternate, and the medians are compared. This needs
two idle cores; the CPU time per trial shows the cost of a second job on a busy machine.

Without --scene it uses scene_a from $MAST_DATA or ../shared/data, or else the generated junction.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tarfile
import tempfile
import time
from contextlib import closing
from pathlib import Path

from mast_zenoh import scenario
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.study import definition, execution
from mast_zenoh.study.trial import Trial
from mast_zenoh.study.trials import plan

DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[2] / "shared" / "data")
SCENARIOS = ("baseline", "uncoordinated", "coordinated")


def whole_runs(name: str, scene: str, repeats: int) -> None:
    """Time runs of one scenario, and print a line."""
    path, loaded = scenario.load(name, [f"scene={scene}"])
    resolved = scenario.resolve(path, loaded)
    cpu, wall, evaluation = [], [], []
    for _ in range(repeats):
        began_cpu, began = time.process_time(), time.perf_counter()
        process = InProcess(resolved)
        results = process.run()
        cpu.append(time.process_time() - began_cpu)
        wall.append(time.perf_counter() - began)
        evaluation.append(wall[-1] - results[""]["wall_s"])
    frames = resolved.frames
    metrics = results["evaluator"]["metrics"]
    picture = next(iter(metrics["agents"].values()))["picture"]
    print(
        f"{name:14}{frames / min(cpu):12.0f}{frames / statistics.median(cpu):10.0f}"
        f"{frames / statistics.median(wall):10.0f}{100 * sum(evaluation) / sum(wall):12.0f} %"
        f"{picture['fn']['mean']:10.2f}{picture['fp']['mean']:6.2f}{picture['rmse_m']:7.3f}"
    )


def one_and_two_jobs(scene: str, trials: int, rounds: int) -> None:
    """Time the same trials with one job and with two."""
    study = definition.load("monte_carlo", [f"scenes={scene}"])
    seeds = -(-trials // len(study.configurations))
    todo = plan(study.chosen(seed=0, runtime="inproc"), count=seeds)[:trials]
    for seed in {trial.seed: trial for trial in todo}.values():
        execution.prepare(seed)  # scenes are prepared before timing starts, for one and two jobs
    rates: dict[int, list[tuple[float, float, float]]] = {1: [], 2: []}
    print(f"{f'{trials} trials':14}{'trials/s':>12}{'without start':>16}{'CPU s/trial':>14}")
    for _ in range(rounds):
        for jobs, measured in rates.items():
            measured.append(timed(todo, jobs))
            print("{:14}{:12.2f}{:16.2f}{:14.3f}".format(f"jobs: {jobs}", *measured[-1]))
    one, two = ([statistics.median(column) for column in zip(*rates[jobs], strict=True)] for jobs in (1, 2))
    print("{:14}{:12.2f}{:16.2f}{:14.2f}".format("2 against 1", *(b / a for a, b in zip(one, two, strict=True))))


def timed(todo: list[Trial], jobs: int) -> tuple[float, float, float]:
    """Trials/s of all, and without the start of the workers; CPU seconds of a trial."""
    began = time.perf_counter()
    ends, cpu = [], []
    with execution.workers(jobs, None) as run_trials, closing(run_trials(todo)) as outcomes:
        for outcome in outcomes:
            assert not outcome.error, outcome.error
            ends.append(time.perf_counter())
            cpu.append(outcome.cpu_s)
    steady = (len(ends) - jobs) / (ends[-1] - ends[jobs - 1])
    return len(ends) / (ends[-1] - began), steady, statistics.mean(cpu)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--trials", type=int, default=140)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene = arguments.scene or "intersection"
        if arguments.scene is None and (DATA / "scene_a.tar.gz").is_file():
            with tarfile.open(DATA / "scene_a.tar.gz") as archive:
                archive.extractall(folder, filter="data")
            scene = f"avstack:{folder}/scene_a"
        print(f"scene: {scene.split('/')[-1]}; load: {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
        headings = f"{'frames/s':14}{'CPU, best':>12}{'median':>10}{'wall':>10}{'evaluation':>14}"
        print(headings + f"{'FN':>10}{'FP':>6}{'RMSE':>7}")
        for name in SCENARIOS:
            whole_runs(name, scene, arguments.repeats)
        print()
        one_and_two_jobs(scene, arguments.trials, arguments.rounds)


if __name__ == "__main__":
    main()
