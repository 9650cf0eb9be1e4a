"""Errors, consistency and processor time of mast's, filterpy's and Stone Soup's trackers on the same scenes."""

from math import inf

from mast_zenoh.metrics.study_results import NAN, Row
from mast_zenoh.show.number_text import measured
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.choices import words
from mast_zenoh.study.defences.kinds import Kind

_AGENTS, _CENTRE = "agents.*.pipeline.tracker", "command_center.pipeline.group_tracking.tracker"
_OWN, _STONE_SOUP = "KalmanBoxTracker3D", dict(type="StoneSoupTracker")
#: By name, where a tracker is in place of mast's own, and which it is; then mast's own without one of its parts.
TRACKERS = {
    "mast": ((), None),
    "interacting models": ((_AGENTS,), dict(type="InteractingModelsTracker3D")),
    "filterpy": ((_AGENTS,), dict(type="FilterpyBoxTracker3D")),
    "Stone Soup in agents": ((_AGENTS,), _STONE_SOUP),
    "Stone Soup everywhere": ((_AGENTS, _CENTRE), _STONE_SOUP),
    "short record of detections": ((_AGENTS,), dict(type=_OWN, memory_s=0.2)),
    "no lasting errors": ((_AGENTS,), dict(type=_OWN, lasting_share=0.0)),
    "twice the clutter": ((_AGENTS,), dict(type=_OWN, clutter_per_m2=1e-4)),
    "half the acceleration": ((_AGENTS,), dict(type=_OWN, acceleration_scale=0.5)),
    "greedy assignment": ((_AGENTS,), dict(type=_OWN, assignment=dict(type="GreedyAssignment"))),
}
#: Measures of the ego's own tracks and of its picture, by heading.
MEASURES = {
    "missed": "fn",
    "false": "fp",
    "RMSE (m)": "rmse_m",
    "ID switches": "id_switches",
    "NEES of positions (2 expected)": "nees",
}
TIME, ESTIMATES = "ms per frame", {"local": "own tracks", "picture": "picture"}


class Trackers(Kind):
    """Trackers side by side. Its factor: tracker."""

    name, drawn = "trackers", ("trackers",)

    def measures(self, factors, outcome):
        """The measures of both estimates of the ego, and ms of processor time per frame of all nodes together."""
        found = {TIME: 1e3 * outcome.cpu_s / outcome.trial.frames}
        for estimate in ESTIMATES:
            scores = outcome.metrics["agents"]["ego"][estimate]
            consistency = outcome.metrics["consistency"]["ego"][estimate]["position"]
            for name in MEASURES.values():
                score = consistency[name] if name == "nees" else scores[name]
                found[f"{estimate} {name}"] = score["mean"] if isinstance(score, dict) else score
        return {name: NAN if value is None else value for name, value in found.items()}

    def table(self):
        """A row for each tracker, with the mean of each measure."""
        names = [TIME, *(f"{estimate} {name}" for estimate in ESTIMATES for name in MEASURES.values())]
        return [
            Row(dict(each), len(done), {name: self.mean(self.values(each, name), (0.0, inf)) for name in names})
            for each, done in self.trials.items()
        ]

    def tables(self, table):
        columns = {
            f"{title}: {heading}": shown(f"{estimate} {name}")
            for estimate, title in ESTIMATES.items()
            for heading, name in MEASURES.items()
        }
        groups = ["", *(title for title in ESTIMATES.values() for _ in MEASURES), TIME]
        page = table_of_rows("Trackers", "", table, columns | {TIME: shown(TIME)})._replace(groups=groups)
        return ResultTables("Trackers", "", self.size, [page], numbers_of_rows(table), [page])

    def figures(self, table):
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        axes = [Axis(f"{estimate} rmse_m", f"RMSE (m): {title}") for estimate, title in ESTIMATES.items()]
        axes += [Axis(f"{estimate} nees", f"NEES: {title}") for estimate, title in ESTIMATES.items()]
        rows = [Row(row.of | {"hue": ""}, row.trials, row.numbers) for row in table]
        figure = facet(rows, "tracker", [*axes, Axis(TIME, TIME)], "hue", size=(2.6, 2.4))
        errors = "; ".join(f"{row.of['tracker']} {measured(row['picture rmse_m'])}" for row in table)
        alt, caption = f"RMSE of the picture (m): {errors}.", f"Bars: 95 % intervals ({self.size})."
        return {self.name: render(self.name, figure, alt, caption, printed=True)}


def study(trackers=None, scenario="baseline", trials=20, frames=100, seed=40):
    """Every tracker in the same runs, each trial at a junction of its own.

    trackers: names in this file, separated by commas; None: all; scenario: of the runs, such as coordinated;
    trials: junctions, each with a seed of its own; seed: the first, number of the junction, too; frames: of each run
    """
    runs = {}
    for name in TRACKERS if trackers is None else words(trackers):
        paths, tracker = TRACKERS[name]
        parameters = dict.fromkeys(paths, tracker)
        runs[name] = dict(scenario=scenario, parameters=parameters, factors=dict(tracker=name))
    study = dict(name="trackers", kind=Trackers, runs=runs, trials=trials, frames=frames, seed=seed)
    return study | dict(per_trial=dict(seed="scene_index"))
