"""Random scenarios, drawn by number: every kind of wire, and lists of no, one, some and all names of agents."""

from typing import Any

import numpy as np

FRAMES = 14
#: Several sensors of some agents, at their own times.
_LIDAR = dict(type="Lidar", rate_hz=5.0, phase_s=0.07)
_RADAR = dict(type="Radar", azimuth_deg=(-60.0, 60.0), range_m=120.0)
_FAULTS: dict[str, dict[str, Any]] = {
    "Partition": {},
    "Loss": dict(probability=0.4),
    "BurstLoss": dict(good_to_bad=0.3, bad_to_good=0.3),
    "Delay": dict(mean_s=0.15, jitter_s=0.1),
    "SlowNode": dict(delay_s=0.2),
    "BandwidthLimit": dict(bits_per_s=400_000.0),
    "Corrupt": dict(probability=0.3, flips=5),
    "Duplicate": dict(probability=0.4, copies=2),
    "Flood": dict(copies=3),
    "Reorder": dict(probability=0.5, by_s=0.2),
    "BlindSector": dict(azimuth_min_deg=-40.0, azimuth_max_deg=30.0),
    "GhostDetections": dict(places=[(20.0, 3.0, 0.8)], frame="sensor"),
}
#: Faults that stop processes, by the parameter that says for how long.
_STOPS = {"Kill": "restart_after", "Leave": "return_after", "Restart": "down_s", "Pause": "until", "Join": ""}


class _Draw:
    """The draws of one scenario. agents: the names of its agents, the ego first"""

    def __init__(self, number: int) -> None:
        self.rng = np.random.default_rng([51, number])
        self.poles, self.cars = int(self.rng.integers(1, 4)), int(self.rng.integers(1, 3))
        self.infra = [f"infra_{k}" for k in range(1, self.poles + 1)]
        self.mobile = [f"mobile_{k}" for k in range(1, self.cars + 1)]
        self.agents = ["ego", *self.mobile, *self.infra]

    def one(self, *values: Any) -> Any:
        return values[int(self.rng.integers(len(values)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def names(self, known: list[str]) -> list[str]:
        """None of these names, one, some or all of them."""
        kind = self.one("none", "one", "some", "all")
        if kind == "some":
            return [name for name in known if self.chance(0.5)]
        return {"none": [], "one": [self.one(*known)], "all": list(known)}[kind]


def drawn(number: int) -> tuple[str, list[str], int]:
    """The scenario of this number, of each kind in turn: its name, settings as for `--set`, and the seed of its run."""
    draw = _Draw(number)
    kind = list(KINDS)[number % len(KINDS)]
    name, settings = KINDS[kind](draw)
    settings |= {"n_infrastructure": draw.poles} | ({} if "n_mobile" in settings else {"n_mobile": draw.cars})
    if kind in ("centre", "peers", "centres") and draw.chance(0.5):
        several = draw.names(draw.agents) or [draw.agents[-1]]
        settings["scene.sensors"] = {agent: [draw.one(_LIDAR, dict(type="Lidar")), _RADAR] for agent in several}
    for agent in draw.names(draw.agents) if draw.chance(0.6) else ():
        settings[f"links.{agent}"] = draw.one("wired", "wireless_v2x", {"up": [dict(type="Loss", probability=0.2)]})
    others = {"peers": [f"peer_{agent}" for agent in draw.agents], "drivers": ["driver_ego"], "channel": ["channel"]}
    if faults := _faults(draw, others.get(kind, ["broker", "command_center"] if kind in ("centre", "defence") else [])):
        settings["faults"] = faults
    return name, [f"{key}={value}" for key, value in settings.items()], int(draw.rng.integers(1000))


def _faults(draw: _Draw, others: list[str]) -> list[dict[str, Any]]:
    """Up to three faults of links and sensors, and at most one of processes. others: nodes that may be stopped, too"""
    faults = []
    for _ in range(int(draw.rng.integers(4))):
        kind = draw.one(*_FAULTS)
        at = round(0.1 * int(draw.rng.integers(0, 8)), 1)
        until = draw.one(None, round(at + 0.1 * int(draw.rng.integers(1, 6)), 1))
        faults.append(dict(type=kind, at=at, until=until, nodes=draw.names(draw.agents), **_FAULTS[kind]))
    if draw.chance(0.5):
        kind = draw.one(*_STOPS)
        stopped = [*draw.agents[1:], *(others if kind != "Pause" else ())]
        at = round(0.1 * int(draw.rng.integers(2, 7)), 1)
        lasts = {_STOPS[kind]: round(at + 0.3, 1) if kind == "Pause" else 0.3} if _STOPS[kind] else {}
        faults.append(dict(type=kind, at=at, nodes=draw.names(stopped), **lasts))
    return faults


def _centre(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Adversaries on detections, tracks or the picture of lists of agents; or a coordinator of some of them."""
    name = draw.one("uncoordinated", "coordinated", "downlink")
    settings: dict[str, Any] = {"attack_start_s": 0.3}
    if name == "downlink":
        return name, settings | {"adversaries.adversary_1.agent": draw.names([draw.one(*draw.agents[:1])])}
    count = int(draw.rng.integers(1, draw.poles + draw.cars + 1))
    settings["n_adversaries"] = count
    victims = draw.names(draw.agents)
    settings["adversaries.adversary_1.agent"] = victims if name == "uncoordinated" else victims[:1]
    if name == "uncoordinated":
        settings["keyexpr.rewrites"] = draw.one(
            ["on_detections.toml"], ["on_tracks.toml"], ["on_detections.toml", "on_tracks.toml"]
        )
    else:
        followers = [f"adversary_{k}" for k in range(2, count + 1)] or ["adversary_1"] * bool(victims)
        settings["coordinator.adversaries"] = draw.names(followers) if followers else []
    return name, settings


def _peers(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Cooperation without a centre, with all that peers can tell each other."""
    awareness = draw.chance(0.5)
    gossip = draw.chance(0.4)
    on = draw.one("sent", "pair", "heard", *["awareness"] * awareness)
    settings: dict[str, Any] = {
        "attack_start_s": 0.3,
        "n_adversaries": int(draw.rng.integers(0, draw.cars + (on != "awareness"))),
        "on": on,
        "awareness": awareness,
        "gossip": gossip,
        "relays": draw.chance(0.4),
        "codec": draw.one("columns", "cpm"),
        "rules": draw.one("EveryFrame", "CpmGeneration"),
        "defence": draw.one(None, "FaultOrLie", "Robosac"),
    }
    settings["n_slanderers"] = int(gossip and draw.chance(0.5))
    if settings["n_adversaries"] and on != "awareness":
        settings["adversaries.adversary_1.agent"] = draw.names(draw.agents if on == "sent" else draw.agents[1:])
    return "peers", settings


def _channel(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Peers on a radio channel."""
    settings: dict[str, Any] = {
        "attack_start_s": 0.3,
        "n_adversaries": draw.one(0, 1),
        "codec": draw.one("columns", "cpm"),
        "rules": draw.one("EveryFrame", "CpmGeneration"),
        "congestion": draw.one("ReactiveDcc", "AdaptiveDcc", "NoCongestionControl"),
        "awareness": draw.chance(0.5),
    }
    if settings["n_adversaries"]:
        settings["adversaries.adversary_1.agent"] = draw.names(draw.agents)
    return "congested", settings


def _centres(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Two centres and a centre of centres, or one on board of the ego."""
    settings: dict[str, Any] = {
        "attack_start_s": 0.3,
        "n_adversaries": draw.one(0, 1, 2),
        "on_board": draw.chance(0.4),
        "border_m": draw.one(0.0, 10.0),
    }
    if settings["n_adversaries"]:
        settings["adversaries.adversary_1.agent"] = draw.names(draw.agents)
    return "two_centres", settings


def _drivers(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Cars that are driven, some of them attacked on any of their wires."""
    settings: dict[str, Any] = {
        "cars": int(draw.rng.integers(1, draw.cars + 2)),
        "defence": draw.one(None, "FaultOrLie"),
        "veto": draw.chance(0.3),
    }
    attack = draw.one(None, "ghost_ahead", "phantom_queue", "hidden_leader", "stale_picture", "SeizedCommands")
    if attack is not None:
        settings |= {"attack": attack, "attack_start_s": 0.3}
        if attack == "phantom_queue" and draw.chance(0.7):
            settings |= {"wire": "tracks", "compromised": [draw.one(*draw.infra)]}
            settings["adversaries.adversary_1.agent"] = draw.names(draw.agents[1:])
    return "driving", settings


def _defence(draw: _Draw) -> tuple[str, dict[str, Any]]:
    """Adversaries that know what the centre thinks, against a defence that asks for views."""
    attack = draw.one(None, "BlindSpot", "Collusion", "Framing", "TrustFlip", "PoseDrift", "PosePert", "PairedDenial")
    settings: dict[str, Any] = {
        "defence": draw.one("FaultOrLie", "Mate", "KOfN", "Cad", "TruthDiscovery"),
        "knowledge": draw.one("own", "picture", "trust"),
        "attack": attack,
        "attack_start_s": 0.3,
        "n_adversaries": draw.one(1, 2),
    }
    victims = draw.names(draw.agents)
    directed = attack in (None, "Collusion", "PairedDenial")
    settings["adversaries.adversary_1.agent"] = victims[:1] if directed else victims
    return "defended", settings


#: What a scenario is about.
KINDS = {
    "centre": _centre,
    "peers": _peers,
    "channel": _channel,
    "centres": _centres,
    "drivers": _drivers,
    "defence": _defence,
}
