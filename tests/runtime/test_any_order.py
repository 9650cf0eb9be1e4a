"""Messages and results of a run depend on neither the order of delivery nor encoding.

tests/testing checks this of every shipped scenario, and tests/simulation of runs whose nodes die, drive or listen; here
are settings and faults that none of them has.
"""

from collections.abc import Callable

import pytest
from fuzzing import Fuzzing
from test_churn import with_steps
from test_inproc import with_loss
from test_links_without_a_centre import IMPERFECT, PROFILE, WORLDS, world
from tiny_world import Run, tiny

from mast_zenoh.config.resolved import Resolved

BY_TWO = ("n_adversaries=2", "attack_start_s=0.2")
LIE = ("n_mobile=0", "n_adversaries=1", "attack_start_s=0.2")
GHOST = dict(type="GhostDetections", at=0.3, until=0.8, places=[(20.0, 15.0, 0.75)], probability=0.5, node="ego")
BLIND = dict(type="BlindSector", at=0.3, until=0.8, azimuth_min_deg=-180.0, azimuth_max_deg=180.0, node="infra_1")
AWARE = ("awareness=true", "on=awareness", "listener=infra_1")


RUNS: dict[str, Callable[[], Resolved]] = {
    "lossy": lambda: tiny("coordinated", *BY_TWO, edit=with_loss),
    "duplicates": lambda: tiny(edit=lambda scenario: with_loss(scenario, doubles=True)),
    "lie between peers": lambda: tiny("peers", *LIE, "on=pair"),
    "lie on a channel": lambda: tiny("congested", *LIE, "on=pair", "background=50", infrastructure=3, frames=15),
    "lie about itself": lambda: tiny("congested", *LIE, *AWARE, frames=15),
    "drawn ghosts": lambda: tiny(edit=lambda scenario: scenario.update(faults=[GHOST, BLIND])),
    "restarted coordinator": lambda: with_steps((4, "kill", "coordinator"), (9, "start", "coordinator")),
    **{" ".join(each): lambda each=each: world(each, IMPERFECT, links=PROFILE) for each in WORLDS},
}


def assert_equal_in(resolved: Resolved, orders: int) -> None:
    """Assert that runs in other orders of delivery, and without encoding, equal the plain one."""
    plain = Run(resolved)
    assert not plain.failures
    for options in (*(dict(shuffle=seed) for seed in range(orders)), dict(encode=False, shuffle=5)):
        other = Run(resolved, **options)
        assert other.messages == plain.messages, options
        assert other.packed == plain.packed, options


@pytest.mark.parametrize("name", RUNS)
def test_any_order_of_delivery_gives_the_same_bytes_and_results_encoded_or_not(name: str) -> None:
    assert_equal_in(RUNS[name](), 3 if name == "lossy" else 1)


@pytest.mark.heavy
def test_any_of_many_orders_gives_the_same_bytes_and_results(fuzzing: Fuzzing) -> None:
    assert_equal_in(tiny("coordinated", *BY_TWO), fuzzing.draws(20, 500))
