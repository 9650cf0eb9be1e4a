from mast_zenoh.scenario import load

_, base = load("baseline")


def scenario(endpoint="tcp/127.0.0.1:7448"):
    # With `acts`, it gets the picture, too.
    zenoh_agent = dict(type="ZenohAgent", file="zenoh_agent.py", endpoint=endpoint, acts=True)
    agent = dict(base["agents"]["*"], **zenoh_agent)
    return base | dict(name="with_tracker", agents=base["agents"] | dict(infra_1=agent))
