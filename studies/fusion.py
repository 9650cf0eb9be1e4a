"""Ways to fuse the tracks of one object: the same agents and scenes, by the picture's errors and consistency."""

#: Group tracking of the centre, or of every peer.
_CHOICES = dict(
    ci=dict(fusion=dict(type="CovarianceIntersectionFusion")),
    ci_optimised=dict(fusion=dict(type="CovarianceIntersectionFusion", weights="optimised")),
    ici=dict(fusion=dict(type="InverseCovarianceIntersectionFusion")),
    ici_optimised=dict(fusion=dict(type="InverseCovarianceIntersectionFusion", weights="optimised")),
    naive=dict(fusion=dict(type="NaiveKalmanFusion")),
    adapted_kalman=dict(
        fusion=dict(type="NaiveKalmanFusion"), tracker=dict(type="KalmanBoxTracker3D", independent_states=True)
    ),
    information_matrix=dict(type="InformationMatrixGroupTracker", fusion=dict(type="CovarianceIntersectionFusion")),
)
_WRAPPER = dict(type="GroupTrackerWrapper", tracker=dict(type="KalmanBoxTracker3D"))


def study(fusions="", first=8, last=9, trials=2, frames=100, seed=3000):
    """Every fusion on the same scenes and seeds, without attack.

    fusions: names in this file, separated by commas; "": all;
    first, last: generated junctions; trials: seeds on each, from `seed` on; frames: of each run.
    """
    chosen = [name.strip() for name in fusions.split(",")] if fusions else list(_CHOICES)
    return dict(
        name="fusion",
        runs={
            name: dict(
                scenario="baseline",
                parameters={"command_center.pipeline.group_tracking": _WRAPPER | _CHOICES[name]},
            )
            for name in chosen
        },
        baseline=chosen[0],
        scenes=[f"intersection:{index}" for index in range(first, last + 1)],
        trials=trials,
        frames=frames,
        runtime="inproc",
        seed=seed,
    )
