"""How the picture degrades when four poles' tracks are late."""

from mast_zenoh.study.choices import words

DELAYS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def study(scenes="intersection:0,intersection:1,intersection:2,intersection:3", late_agents="infra_*", delays_s=DELAYS):
    """Runs for delays from 0 to 1 s.

    scenes: short names, separated by commas; empty: each seed has a junction of its own;
    late_agents: pattern of the names of the agents whose messages are late; delays_s: s, each of them
    """
    return dict(
        name="delay",
        runs=dict(
            delayed=dict(
                scenario="delayed",
                parameters=dict(late_agents=late_agents),
                grid=dict(delay_s=delays_s),
            ),
        ),
        per_trial={} if scenes else dict(seed="scene_index"),
        scenes=words(scenes) or [{}],
        frames=150,
        trials=2,
        seed=0,
    )
