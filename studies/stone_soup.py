"""The trackers of mast and of Stone Soup on the same scene, with and without a coordinated attack."""

from mast_zenoh.study.choices import words


def study(scene="intersection", trackers="mast,agents,everywhere", frames=150, attack_start_s=2.0, builder=""):
    """Every combination of tracker and attack, once.

    scene: a short name such as "intersection" or "avstack:PATH";
    trackers: separated by commas: mast, its own trackers; agents, Stone Soup's tracker for the agents; everywhere, for
    the agents and the command centre;
    frames: of each run; attack_start_s: s of scene time at which the adversaries begin;
    builder: FILE.py:FUNCTION that returns the Stone Soup tracker, in the current folder; "": the default tracker.
    """
    places = dict(
        mast=(),
        agents=("agents.*.pipeline.tracker",),
        everywhere=("agents.*.pipeline.tracker", "command_center.pipeline.group_tracking.tracker"),
    )
    tracker = dict(type="StoneSoupTracker", builder=builder)
    chosen = words(trackers)
    return dict(
        name="stone_soup",
        runs={
            f"{tracking}_{attack}": dict(
                scenario=scenario, parameters=dict(scene=scene, **extra, **dict.fromkeys(places[tracking], tracker))
            )
            for attack, scenario, extra in (
                ("baseline", "baseline", {}),
                ("coordinated", "coordinated", dict(attack_start_s=attack_start_s)),
            )
            for tracking in chosen
        },
        frames=frames,
        runtime="inproc",
        seed=0,
    )
