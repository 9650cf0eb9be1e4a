"""Tracks that reach the command centre late."""

from baseline import scenario as baseline


def scenario(
    delay_s=0.3,
    jitter_s=0.0,
    late_agents="infra_*",
    max_age_s=1.0,
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """A run in which the messages of some agents to the command centre are late.

    delay_s, jitter_s: mean and standard deviation of the delay; late_agents: pattern of the agents' names;
    max_age_s: the maximum age of an agent's tracks that the command centre uses.
    """
    delay = dict(type="Delay", mean_s=delay_s, jitter_s=jitter_s)
    place = dict(scene=scene, scene_index=scene_index, n_infrastructure=n_infrastructure, n_mobile=n_mobile)
    return baseline(**place) | dict(
        name="delayed",
        links={late_agents: dict(up=[delay])},
        broker=dict(latency_s=0.0, max_age_s=max_age_s),
    )
