"""What natural faults of one agent cost the picture, without an attack, each trial at a junction of its own."""

from mast_zenoh.study.choices import FAULTS, words


def study(faults=None, n_faulty=1, defence="NoIntegrity", trials=30, frames=80, fault_start_s=2.0, seed=40):
    """Paired runs: the same junctions and seeds for every fault.

    faults: pose, delay, skew, loss, blind, ghosts, separated by commas; None: all;
    n_faulty: agents that have it, poles first; defence: an integrity stage;
    trials: junctions, each with a seed of its own; seed: the first, number of the junction, too;
    frames: of each run; fault_start_s: when the faults begin
    """
    common = dict(defence=defence, n_adversaries=0, placement="poles", attack_start_s=fault_start_s)
    return dict(
        name="faults",
        runs=dict(baseline=dict(scenario="defence_cell", parameters=common))
        | {
            name: dict(scenario="defence_cell", parameters=common | dict(fault=name, n_faulty=n_faulty))
            for name in (FAULTS if faults is None else words(faults))
        },
        per_trial=dict(seed="scene_index"),
        trials=trials,
        frames=frames,
        seed=seed,
    )
