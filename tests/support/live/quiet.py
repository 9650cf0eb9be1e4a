"""A cheap scenario of 200 repetitions: two agents, two cars, a listener."""

from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    made = baseline(n_infrastructure=1)
    scene = made["scene"] | dict(n_vehicles=2, n_bicycles=0, n_pedestrians=0)
    return made | dict(name="quiet", scene=scene, evaluator=dict(file="listener.py"))
