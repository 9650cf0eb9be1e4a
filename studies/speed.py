"""How fast a run in one process is, by the number of its agents and of the objects around them."""

from math import inf

from mast_zenoh.metrics.study_results import Row
from mast_zenoh.show.findings.words import of_study
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.choices import sensors_of
from mast_zenoh.study.defences.kinds import Kind

RATE, OBJECTS = "frames/s", "objects"
#: By the name of a run, its scenario and parameters.
RUNS = {"baseline": ("baseline", {}), "attacked": ("coordinated", dict(attack_start_s=1.0))}


class Speed(Kind):
    """Frames of each second of processor time, evaluation apart. Its factors: run; agents."""

    name, drawn = "speed", ("speed",)

    def measures(self, factors, outcome):
        """Frames per s of processor time; objects in range of the ego per frame."""
        picture = outcome.metrics["agents"]["ego"]["picture"]
        objects = picture["tp"]["mean"] + picture["fn"]["mean"]
        return {RATE: outcome.trial.frames / outcome.cpu_s, OBJECTS: objects}

    def table(self):
        """A row for each run and number of agents."""
        return [
            Row(
                dict(each),
                len(done),
                {name: self.mean(self.values(each, name), (0.0, inf)) for name in (RATE, OBJECTS)},
            )
            for each, done in self.trials.items()
        ]

    def tables(self, table):
        columns = {RATE: shown(RATE), "objects in range": shown(OBJECTS)}
        page = table_of_rows("Frames/s in one process", "", table, columns, texts=2)
        sentences = of_study("speed", rows=table)
        return ResultTables("Speed", "", self.size, [page], numbers_of_rows(table), [page], reading=sentences)

    def figures(self, table):
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        axis = Axis(RATE, "frames per s of processor time", log=True)
        figure = facet(table, "agents", [axis], "run", label="agents", log=True)
        caption = f"Frames per second of processor time in one process, with 95 % intervals ({self.size})."
        return {self.name: render(self.name, figure, " ".join(of_study("speed", rows=table)), caption)}


def study(agents=(5, 10, 20, 29), scenes="intersection:8", trials=10, frames=100, seed=0):
    """A baseline and an attacked run for each number of agents: the ego, poles, and above five cars.

    agents: their numbers, 2 to 29; scenes: short names, separated by commas; trials: seeds of each; seed: the first;
    frames: of each run
    """
    return dict(
        name="speed",
        kind=Speed,
        runs={
            f"{name} {count} agents": dict(
                scenario=scenario, parameters=sensors_of(count) | parameters, factors=dict(run=name, agents=count)
            )
            for name, (scenario, parameters) in RUNS.items()
            for count in agents
        },
        scenes=scenes.split(","),
        trials=trials,
        frames=frames,
        seed=seed,
    )
