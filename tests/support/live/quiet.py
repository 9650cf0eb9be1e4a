"""A cheap scenario of 200 repetitions: two agents, two cars, a listener."""

from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario():
    resolved_scenario = baseline(n_infrastructure=1)
    scene = resolved_scenario["scene"] | dict(n_vehicles=2, n_bicycles=0, n_pedestrians=0)
    return resolved_scenario | dict(name="quiet", scene=scene, evaluator=dict(file="listener.py"))
