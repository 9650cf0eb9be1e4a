import mast_zenoh as mast
from mast_zenoh.scenario import load
from mast_zenoh.show import RunFigure


class Crowd(RunFigure):
    """Objects in the scene and in the common picture, frame by frame."""

    heading = "How crowded it is"
    after = "time"

    def draw(self, context):
        from matplotlib.figure import Figure  # imported here, because the processes of nodes load this file too

        run = mast.open(context.folder)
        figure = Figure(figsize=(10, 3), layout="constrained")
        axes = figure.subplots()
        for name, table in (("scene", run.truth), ("picture", run.picture)):
            objects = table.group_by("time_s").aggregate([("id", "count")]).sort_by("time_s")
            axes.plot(objects["time_s"], objects["id_count"], label=name)
        axes.set(xlabel="time (s)", ylabel="objects")
        axes.legend()
        return figure


def scenario():
    _, base = load("baseline")
    return base | dict(name="crowd")
