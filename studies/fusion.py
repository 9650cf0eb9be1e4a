"""Ways to fuse the tracks of one object, in the same scene: the errors and the consistency of the picture."""

from mast_zenoh.study.choices import words

#: Group tracking of a command centre or of a peer.
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
_ON_BOARD = "peers.*.pipeline.group_tracking"
_PLACES = dict(
    centre=("baseline", "command_center.pipeline.group_tracking", {}),
    peers=("peers", _ON_BOARD, {}),
    cpm=("peers", _ON_BOARD, dict(codec="cpm", rules="CpmGeneration")),
    rumours=("peers", _ON_BOARD, dict(relays=True)),
)


def study(scene="intersection:8", fusions=None, place="centre", frames=100, seed=3000):
    """Every fusion once, without attack; the report of each run says how consistent the picture is.

    scene: a short name such as "intersection" or "avstack:PATH"; fusions: names in this file, separated by commas;
    None: all of them;
    place: centre, a command centre; peers, each agent fuses what it hears; cpm, peers that hear Collective Perception
    Messages, at the times that the standard's rules say; rumours, peers that also relay their pictures, so that
    information comes back to its sender;
    frames: of each run; seed: of all random draws.
    """
    chosen = list(_CHOICES) if fusions is None else words(fusions)
    scenario, path, parameters = _PLACES[place]
    return dict(
        name="fusion",
        runs={
            name: dict(
                scenario=scenario, parameters=dict(scene=scene, **parameters, **{path: _WRAPPER | _CHOICES[name]})
            )
            for name in chosen
        },
        frames=frames,
        runtime="inproc",
        seed=seed,
    )
