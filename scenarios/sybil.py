"""A run in which two agents of the scenario are late, for `mast study sybil`: an outsider pretends to be them."""

from baseline import scenario as baseline


def scenario(scene="intersection", scene_index=None):
    """A baseline run in real time; the last two of four roadside agents join after 12 s."""
    return baseline(scene, scene_index, n_infrastructure=4) | dict(
        name="sybil",
        faults=[dict(type="Join", at=12.0, nodes=["infra_3", "infra_4"])],
        run=dict(mode="realtime", rate=0.25, seed=0, record=False),
    )
