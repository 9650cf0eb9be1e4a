"""No attack: undisturbed collaboration, the reference for other scenarios."""

from copy import deepcopy

from mast_zenoh.scenario import choose_scene

# The command centre's pipeline for the agents' tracks: the paper's configuration listing.
commandcenter = dict(
    type="CommandCenter",
    pipeline=dict(
        type="CommandCenterPipeline",
        clustering=dict(type="SampledAssignmentClusterer", assign_radius=2.0),
        group_tracking=dict(
            type="GroupTrackerWrapper",
            # Detectors of different agents err independently; nine tenths leave room for poses and clocks.
            fusion=dict(type="CovarianceIntersectionFusion", independent_share=0.9),
            tracker=dict(type="KalmanBoxTracker3D"),
        ),
    ),
)

# Every agent's pipeline for its detections, and for the picture that it receives.
agent = dict(
    pipeline=dict(
        type="AgentPipeline",
        tracker=dict(type="KalmanBoxTracker3D"),
        mission=dict(type="OwnAndPicture", radius=2.0),
    ),
)


def scenario(scene="intersection", scene_index=None, n_infrastructure=None, n_mobile=None):
    """A run without attack on any scene.

    scene: a short name such as "intersection" or "avstack:PATH"; scene_index: number of a generated junction;
    n_infrastructure, n_mobile: numbers of poles, and of cars besides the ego, with sensors; None: all of the scene.
    """
    return dict(
        name="baseline",
        scene=choose_scene(scene, scene_index=scene_index, n_infrastructure=n_infrastructure, n_mobile=n_mobile),
        agents={"*": deepcopy(agent)},  # other scenarios change their copies
        broker=dict(latency_s=0.0),
        command_center=deepcopy(commandcenter),
        evaluator=dict(scorer=dict(type="Scorer", range_m=100.0)),
        keyexpr=dict(map="testbed.toml", rewrites=[]),
        run=dict(mode="lockstep", seed=0),
    )
