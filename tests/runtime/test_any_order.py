"""Messages and results of a run depend on neither the order of delivery nor encoding.

tests/testing checks this of every shipped scenario; here are settings, faults and nodes that none of them has.
"""

from collections.abc import Callable

import pytest
from driven import driven, over_a_rough_link
from fuzzing import Fuzzing
from test_churn import EVERYONE, with_steps
from test_driven_runs import SEIZED
from test_inproc import with_loss
from test_links_without_a_centre import IMPERFECT, PROFILE, WORLDS, world
from test_listening import shadowed
from tiny_world import Run, tiny

from mast_zenoh.config.resolved import Resolved

BY_TWO = ("n_adversaries=2", "attack_start_s=0.2")
ATTACKED = {"uncoordinated": (*BY_TWO, "fraction_translations=0.5"), "coordinated": BY_TWO, "baseline": ()}
LIE = ("n_mobile=0", "n_adversaries=1", "attack_start_s=0.2")
GHOST = dict(type="GhostDetections", at=0.3, until=0.8, places=[(20.0, 15.0, 0.75)], probability=0.5, node="ego")
BLIND = dict(type="BlindSector", at=0.3, until=0.8, azimuth_min_deg=-180.0, azimuth_max_deg=180.0, node="infra_1")
AWARE = ("awareness=true", "on=awareness", "listener=infra_1")


def restarted(node: str) -> Resolved:
    """A run in which a node is killed and returns, then leaves and returns."""
    return with_steps((4, "kill", node), (9, "start", node), (11, "leave", node), (13, "start", node))


RUNS: dict[str, Callable[[], Resolved]] = {
    **{f"lossy {name}": lambda name=name: tiny(name, *ATTACKED[name], edit=with_loss) for name in ATTACKED},
    "duplicates": lambda: tiny(edit=lambda scenario: with_loss(scenario, doubles=True)),
    "lie between peers": lambda: tiny("peers", *LIE, "on=pair"),
    "lie on a channel": lambda: tiny("congested", *LIE, "on=pair", "background=50", infrastructure=3, frames=15),
    "lie about itself": lambda: tiny("congested", *LIE, *AWARE, frames=15),
    "seized commands": lambda: driven(*SEIZED, edit=over_a_rough_link),
    "drawn ghosts": lambda: tiny(edit=lambda scenario: scenario.update(faults=[GHOST, BLIND])),
    "listening adversary": lambda: tiny(edit=shadowed),
    **{" ".join(each): lambda each=each: world(each, IMPERFECT, links=PROFILE) for each in WORLDS},
    **{f"restarted {node}": lambda node=node: restarted(node) for node in EVERYONE},
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
    assert_equal_in(RUNS[name](), 3 if name.startswith("lossy") else 1)


@pytest.mark.heavy
@pytest.mark.parametrize("name", ATTACKED)
def test_any_of_many_orders_gives_the_same_bytes_and_results(name: str, fuzzing: Fuzzing) -> None:
    assert_equal_in(tiny(name, *ATTACKED[name]), fuzzing.draws(20, 500))
