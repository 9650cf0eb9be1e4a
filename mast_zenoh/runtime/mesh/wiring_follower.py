"""A node's part in a change of the wiring, which `wiring_coordinator` describes."""

from __future__ import annotations

import time
from collections.abc import Callable

import zenoh

from mast_zenoh.control.flow import WiringUpdate
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.mesh.drain import DrainQueries
from mast_zenoh.runtime.mesh.outlets import Outlets
from mast_zenoh.wiring.insertion import taps_into
from mast_zenoh.wiring.model import Ports, Wiring


class WiringFollower:
    """Applies the wiring updates of epochs: subscribes to new keys, and moves outlets.

    ports:  of the node when it was started;  drains: answers other nodes' queries, which depend on the wiring too
    subscribe: subscribes this node to a key
    ask:    asks a node whether it has forwarded an outlet's messages on a key; the answer is an event, see `resume`
    report: sends the driver this node's counts
    """

    def __init__(
        self,
        name: str,
        host: Host,
        ports: Ports,
        outlets: Outlets,
        drains: DrainQueries,
        *,
        lockstep: bool,
        subscribe: Callable[[str], None],
        ask: Callable[[str, str, str], None],
        report: Callable[[], None],
    ) -> None:
        self._name = name
        self._host = host
        self._ports = ports
        self._outlets = outlets
        self._drains = drains
        self._lockstep = lockstep
        self._subscribe = subscribe
        self._ask = ask
        self._report = report
        self._next: dict[str, tuple[str, zenoh.Publisher]] = {}  # next key and publisher, by outlet
        self._draining: dict[str, float] = {}  # when each outlet began to hold messages back

    @property
    def wiring(self) -> Wiring:
        """The node's current wiring."""
        return self._drains.wiring

    @property
    def busy(self) -> bool:
        """Whether an outlet still holds messages back."""
        return bool(self._draining)

    def follow(self, update: WiringUpdate) -> None:
        """Apply the update of an epoch."""
        self._prepare(update.wiring)
        leaving = self._name in update.leaving
        self._drains.enter_epoch(leaving=leaving)
        if leaving and self._lockstep:
            self._host.flush()
        if update.active:
            self._switch(update)

    def resume(self, outlet_key: str, interposer: str, answered: bool) -> None:
        """Release an outlet: the interposer has forwarded everything, or does not answer."""
        held_s = time.monotonic() - self._draining.pop(outlet_key)
        kept = self._move(outlet_key)
        if answered:
            self._host.log.info("%d messages waited %.1f ms for %s", kept, held_s * 1e3, interposer)
        else:
            self._host.log.warning(
                "%s has not confirmed within %.1f s that it forwarded everything: messages may be lost; %d waited",
                *(interposer, held_s, kept),
            )
        self._report()

    def _prepare(self, wiring: Wiring) -> None:
        """Subscribe to new keys, and declare publishers for keys that change."""
        ports = wiring.ports(self._name)
        for key, port_input in ports.inputs.items():
            if key not in self._host.subscriptions:
                self._host.add_input(key, port_input)
                self._subscribe(key)
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        new = []
        for end, outlet_key in self._ports.outputs.items():
            outlet, key = self._outlets[outlet_key], ports.outputs.get(end, "")
            if outlet_key in self._draining or key == self._next.get(outlet_key, (outlet.key,))[0]:
                continue
            if outlet_key in self._next:  # of a cancelled change
                self._next.pop(outlet_key)[1].undeclare()
            if key not in ("", outlet.key):
                self._next[outlet_key] = key, self._outlets.declare_publisher(key, types[key])
                new.append(self._next[outlet_key][1])
        if new:
            self._outlets.await_subscribers(new)

    def _switch(self, update: WiringUpdate) -> None:
        """Publish on the new keys, now or after the interposer has forwarded everything."""
        taps = {} if self._lockstep else taps_into(self.wiring, update.leaving)
        for outlet_key in [key for key in self._next if key not in self._draining]:
            outlet = self._outlets[outlet_key]
            interposer = taps.get(outlet.key)
            if interposer is None:
                self._move(outlet_key)
            else:
                outlet.hold_back()
                self._draining[outlet_key] = time.monotonic()
                self._ask(interposer, outlet.key, outlet_key)
        self._drains.wiring = update.wiring

    def _move(self, outlet_key: str) -> int:
        return self._outlets[outlet_key].move(*self._next.pop(outlet_key))
