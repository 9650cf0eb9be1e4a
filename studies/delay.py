"""How the picture degrades when four poles' tracks are late."""

from mast_zenoh.study.choices import words


def study(scenes="intersection:0,intersection:1,intersection:2,intersection:3", late_agents="infra_*"):
    """Runs for delays from 0 to 1 s.

    scenes: short names, separated by commas; late_agents: pattern of the names of the agents whose messages are late
    """
    return dict(
        name="delay",
        runs=dict(
            delayed=dict(
                scenario="delayed",
                parameters=dict(late_agents=late_agents),
                grid=dict(delay_s=(0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)),
            ),
        ),
        scenes=words(scenes),
        frames=150,
        trials=2,
        seed=0,
    )
