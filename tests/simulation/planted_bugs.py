"""Bugs that earlier versions had, or of their kinds, planted into the protocols one at a time.

Each is a function that changes the protocols through a MonkeyPatch. Its docstring says what is wrong then.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from mast_zenoh.launch import launcher_protocol
from mast_zenoh.mesh import host
from mast_zenoh.mesh.control.flow import END
from mast_zenoh.mesh.protocol import driver, node, pacer, rewiring, traffic
from mast_zenoh.mesh.protocol.events import MessageEvent
from mast_zenoh.mesh.protocol.traffic import ATTACHMENT
from mast_zenoh.testing.simulation import simulation

Plant = Callable[[pytest.MonkeyPatch], None]


def counts_go_on_at_a_join(patch: pytest.MonkeyPatch) -> None:
    """Messages of earlier epochs are counted again when a node joins."""
    patch.setattr(host.Host, "reset_counts", lambda self: None)


def early_messages_are_delivered_twice(patch: pytest.MonkeyPatch) -> None:
    """Messages that wait for their epoch are delivered when it begins, and once more."""
    original = traffic.Receiving.deliver_early

    def twice(self: traffic.Receiving) -> None:
        waiting = list(self._early)
        original(self)
        for message in waiting:
            self.deliver(message)

    patch.setattr(traffic.Receiving, "deliver_early", twice)


def early_messages_are_lost(patch: pytest.MonkeyPatch) -> None:
    """Messages of an epoch that the node has not entered yet are lost."""
    patch.setattr(traffic.Receiving, "_keep", lambda self, message: None)


def a_new_process_handles_what_was_sent_before_it_joined(patch: pytest.MonkeyPatch) -> None:
    """A process handles messages of epochs before its first, and answers before its publishers are matched."""
    original = traffic.Receiving.enter_epoch

    def keep_all(self: traffic.Receiving, epoch: int) -> None:
        waiting = list(self._early)
        original(self, epoch)
        self._early = waiting

    patch.setattr(traffic.Receiving, "enter_epoch", keep_all)


def the_stamp_is_of_an_older_step(patch: pytest.MonkeyPatch) -> None:
    """Messages have the stamp of the step before, so that they are handled before their clock."""
    original = ATTACHMENT.pack

    class Late:
        size = ATTACHMENT.size

        @staticmethod
        def pack(mark: bytes, epoch: int, step: int) -> bytes:
            return original(mark, epoch, max(-1, step - 1))

    patch.setattr(traffic, "ATTACHMENT", Late)


def the_epoch_of_the_stamp_is_old(patch: pytest.MonkeyPatch) -> None:
    """Messages have the stamp of the node's first epoch."""
    original = traffic.Outlets.send

    def old(self: traffic.Outlets, message: Any, epoch: int) -> None:
        original(self, message, min(epoch, 1))

    patch.setattr(traffic.Outlets, "send", old)


def counts_of_an_older_epoch_are_taken(patch: pytest.MonkeyPatch) -> None:
    """A report that was under way when an epoch began is taken for one of this epoch."""
    original = pacer.Pacer.report

    def any_epoch(self: pacer.Pacer, name: str, epoch: int, *counts: Any) -> str:
        return original(self, name, self.epoch, *counts)

    patch.setattr(pacer.Pacer, "report", any_epoch)


def a_stall_is_taken_for_an_end(patch: pytest.MonkeyPatch) -> None:
    """The driver ends the run as if the scene were over when the mesh does not become quiet."""
    patch.setattr(driver.DriverProtocol, "_stalled", lambda self, detail: self._end_reason or END)


def the_stop_overtakes_the_last_frame(patch: pytest.MonkeyPatch) -> None:
    """The driver stops all nodes as soon as it has sent the last frame."""
    patch.setattr(driver.DriverProtocol, "_await_quiet", _only_between_frames(driver.DriverProtocol._await_quiet))


def _only_between_frames(original: Any) -> Any:
    def quiet(self: driver.DriverProtocol, **options: Any) -> Iterator[Any]:
        last = self.frames >= self.host.node.frames and not self.membership.differs(self.members)
        return (yield from original(self, **options)) if not last else None

    return quiet


def the_next_frame_waits_for_no_node(patch: pytest.MonkeyPatch) -> None:
    """A frame begins when all nodes have reported, whatever they have handled."""
    patch.setattr(pacer.Pacer, "quiet", lambda self, **options: not self.silent)


def listeners_are_not_waited_for_at_the_end(patch: pytest.MonkeyPatch) -> None:
    """The driver ends the run while messages are on the way to nodes that only listen."""
    original = driver.DriverProtocol._await_quiet

    def without_listeners(self: driver.DriverProtocol, *, include_listeners: bool = False) -> Any:
        last = self.frames >= self.host.node.frames  # type: ignore[attr-defined]
        return original(self, include_listeners=include_listeners and not last)

    patch.setattr(driver.DriverProtocol, "_await_quiet", without_listeners)


def listeners_are_not_waited_for_before_a_change(patch: pytest.MonkeyPatch) -> None:
    """An epoch of a wiring change begins while messages are on the way to nodes that only listen."""

    def at_once(self: driver.DriverProtocol) -> Any:
        while self.rewiring.advance():
            if reason := (yield from self._await_quiet(include_listeners=True)):
                return reason
        return None

    patch.setattr(driver.DriverProtocol, "_rewire", at_once)


def a_dead_node_is_waited_for(patch: pytest.MonkeyPatch) -> None:
    """The driver waits for the counts of a node that has died."""
    patch.setattr(pacer.Pacer, "drop", lambda self, nodes: None)


def a_node_that_returns_at_once_is_not_noticed(patch: pytest.MonkeyPatch) -> None:
    """A node that dies and returns while a frame lasts never takes part again."""
    original = pacer.Membership._lose

    def forget(self: pacer.Membership, *arguments: Any) -> str:
        problem = original(self, *arguments)
        self.replaced.clear()
        return problem

    patch.setattr(pacer.Membership, "_lose", forget)


def publishers_do_not_wait_for_subscribers(patch: pytest.MonkeyPatch) -> None:
    """A node reports although its publishers do not know their subscribers yet."""
    patch.setattr(node.NodeProtocol, "_match", lambda self, wiring: None)


def a_wiring_change_reaches_one_side_only(patch: pytest.MonkeyPatch) -> None:
    """An inserted node subscribes to its new key, but the publisher keeps the old one."""

    def keep(self: rewiring.WiringFollower, update: Any) -> None:
        self.wiring = update.wiring

    patch.setattr(rewiring.WiringFollower, "_switch", keep)


def the_wiring_changes_before_all_are_ready(patch: pytest.MonkeyPatch) -> None:
    """The driver makes a new wiring active before all nodes have reported that they are ready."""
    patch.setattr(pacer.Pacer, "silent", property(lambda self: set()))


def a_drain_ends_early(patch: pytest.MonkeyPatch) -> None:
    """A node that is released says that it has forwarded everything while it still keeps messages."""
    patch.setattr(rewiring.WiringFollower, "_forwarded", lambda self, key, frame: True)
    patch.setattr(host.Host, "flush", lambda self: None)


def messages_are_not_held_back(patch: pytest.MonkeyPatch) -> None:
    """A publisher bypasses a released node before this has forwarded everything; both orders are possible."""
    patch.setattr(rewiring, "taps_into", lambda wiring, nodes: {})


def held_back_messages_are_lost(patch: pytest.MonkeyPatch) -> None:
    """What a publisher has held back is lost when it moves."""
    original = traffic.Outlets.move

    def forget(self: traffic.Outlets, outlet: traffic.Outlet, key: str) -> int:
        outlet.held = None
        return original(self, outlet, key)

    patch.setattr(traffic.Outlets, "move", forget)


def all_nodes_begin_with_the_planned_wiring(patch: pytest.MonkeyPatch) -> None:
    """A node that starts while another is being inserted begins with a wiring that is not in use yet."""

    def planned(self: launcher_protocol.RunState, name: str) -> Any:
        return self.joining[1] if self.joining else self.resolved

    patch.setattr(launcher_protocol.RunState, "resolved_for", planned)


def dropped_messages_are_not_counted(patch: pytest.MonkeyPatch) -> None:
    """A full inbox drops messages, and the driver is not told."""
    patch.setattr(traffic.Receiving, "note_dropped", lambda self, dropped: None)


def a_node_reports_before_it_has_handled(patch: pytest.MonkeyPatch) -> None:
    """A node counts a message as handled before it has sent what this one causes."""
    original = host.Host._handle

    def early(self: host.Host, key: str, port_input: Any, received: Any, counted: bool) -> None:
        report = getattr(self, "report_now", None)
        if counted:
            self.handled[key] += 1
        if report is not None:
            report()
        original(self, key, port_input, received, False)

    init = node.NodeProtocol.__init__

    def reporting(self: node.NodeProtocol, *arguments: Any, **options: Any) -> None:
        init(self, *arguments, **options)
        self.host.report_now = self.report  # type: ignore[attr-defined]

    patch.setattr(host.Host, "_handle", early)
    patch.setattr(node.NodeProtocol, "__init__", reporting)


def a_stop_signal_waits_for_no_results(patch: pytest.MonkeyPatch) -> None:
    """A stop signal ends all nodes before they have handed in their results."""
    patch.setattr(launcher_protocol, "INTERRUPT_GRACE_S", 0.0)


def a_node_that_may_end_ends_the_run(patch: pytest.MonkeyPatch) -> None:
    """The launcher takes every node for one without which the run fails."""
    original = launcher_protocol.Endings._handle_exit

    def needed(self: launcher_protocol.Endings, child: Any) -> None:
        child.spec = replace(child.spec, on_exit="fail")
        original(self, child)

    patch.setattr(launcher_protocol.Endings, "_handle_exit", needed)


def another_node_is_told_as_lost(patch: pytest.MonkeyPatch) -> None:
    """The loss of a node is noted under the driver's name."""
    original = pacer.Membership._lose

    def mistaken(self: pacer.Membership, *arguments: Any) -> str:
        known = len(self.churn)
        problem = original(self, *arguments)
        for event in self.churn[known:]:
            event["node"] = self.own
        return problem

    patch.setattr(pacer.Membership, "_lose", mistaken)


def a_step_that_came_too_late_is_undone(patch: pytest.MonkeyPatch) -> None:
    """A node that dies just before the scenario kills it is restarted, as if the scenario had not."""
    original = launcher_protocol.Steps._do

    def not_the_dead(self: launcher_protocol.Steps, frame: int, action: str, name: str) -> bool:
        child = self._supervisor.children.get(name)
        return not (child and child.exit is not None and action == "kill") and original(self, frame, action, name)

    patch.setattr(launcher_protocol.Steps, "_do", not_the_dead)


def the_last_exit_is_not_handled(patch: pytest.MonkeyPatch) -> None:
    """A node that dies between two looks of the launcher, as the last one, has ended well."""
    original = launcher_protocol.Endings._handle_exit

    def not_the_last(self: launcher_protocol.Endings, child: Any) -> None:
        if self._supervisor.running():
            original(self, child)

    patch.setattr(launcher_protocol.Endings, "_handle_exit", not_the_last)


def a_death_is_taken_for_an_end(patch: pytest.MonkeyPatch) -> None:
    """The launcher does not mind how a process has ended."""
    patch.setattr(launcher_protocol.Endings, "_handle_exit", lambda self, child: None)


def losses_are_not_told(patch: pytest.MonkeyPatch) -> None:
    """The driver keeps to itself that a node was lost and has come back."""
    original = driver.DriverProtocol._outcome
    patch.setattr(driver.DriverProtocol, "_outcome", lambda self: original(self) | {"churn": []})


def steps_do_not_wait_for_a_quiet_mesh(patch: pytest.MonkeyPatch) -> None:
    """The scenario ends nodes while messages are on their way to them."""
    original = driver.DriverProtocol._carry_out

    def at_once(self: driver.DriverProtocol) -> Any:
        if not any(self.timetable.before(self.frames, self.membership.alive)):
            return None
        quiet = self._await_quiet
        self._await_quiet = _immediately  # type: ignore[assignment,method-assign]
        try:
            return (yield from original(self))
        finally:
            self._await_quiet = quiet  # type: ignore[method-assign]

    patch.setattr(driver.DriverProtocol, "_carry_out", at_once)


def _immediately(**options: Any) -> Iterator[Any]:
    return
    yield


def an_end_is_believed_of_any_reason(patch: pytest.MonkeyPatch) -> None:
    """The launcher takes every reason of the driver for the end of the scene."""
    patch.setattr(launcher_protocol, "decode_reason", lambda text: END)


def a_cancelled_change_is_not_awaited(patch: pytest.MonkeyPatch) -> None:
    """After a wiring change that was cancelled, the next frame begins before all nodes know it."""

    def at_once(self: driver.DriverProtocol) -> Any:
        under_way = self.rewiring.due
        while under_way:
            if reason := (yield from self._await_quiet(include_listeners=True)):
                return reason
            under_way = self.rewiring.advance()
        return None

    patch.setattr(driver.DriverProtocol, "_rewire", at_once)


def a_change_hides_who_has_come(patch: pytest.MonkeyPatch) -> None:
    """After a wiring change a frame begins without nodes that have returned meanwhile."""
    rewire, send = driver.DriverProtocol._rewire, driver.DriverProtocol._send_frame

    def look_away(self: driver.DriverProtocol) -> Any:
        due = self.rewiring.due
        reason = yield from rewire(self)
        if due:
            self.membership.differs = lambda members: False  # type: ignore[method-assign]
        return reason

    def look_again(self: driver.DriverProtocol) -> bool:
        vars(self.membership).pop("differs", None)
        return send(self)

    patch.setattr(driver.DriverProtocol, "_rewire", look_away)
    patch.setattr(driver.DriverProtocol, "_send_frame", look_again)


def a_node_that_comes_or_goes_before_steps_is_not_noticed(patch: pytest.MonkeyPatch) -> None:
    """A frame begins without a node that has returned before it, if the node of the frame's only step has died."""
    original = driver.DriverProtocol._carry_out

    def look_once(self: driver.DriverProtocol) -> Any:
        due = self.lockstep and any(self.timetable.before(self.frames, self.membership.alive))
        if due and (reason := (yield from self._await_quiet(include_listeners=True))):
            return reason
        left = any(self.timetable.before(self.frames, self.membership.alive))
        return (yield from original(self)) if left else None

    patch.setattr(driver.DriverProtocol, "_carry_out", look_once)


def a_loss_after_the_end_is_not_told(patch: pytest.MonkeyPatch) -> None:
    """A node dies when the driver has ended the run; what its new process hands in are taken for its results."""
    original = launcher_protocol.churn_of

    def driver_only(outcomes: Any, state: Any) -> Any:
        state.restarted.clear()
        return original(outcomes, state)

    patch.setattr(simulation, "churn_of", driver_only)


def a_full_inbox_drops_the_clock(patch: pytest.MonkeyPatch) -> None:
    """Clocks take the same room as other messages of the driver; without its clock a frame's messages are held."""

    def receive(self: node.NodeProtocol, message: MessageEvent) -> bool:
        counted = self.receiving.counted_epoch(message.epoch)
        return self.inbox.put_message(self.host.publisher(message.key), message, counted)

    patch.setattr(node.NodeProtocol, "receive_message", receive)


def a_node_that_does_not_finish_is_forgotten(patch: pytest.MonkeyPatch) -> None:
    """A run ends well although a node that it needs has not handed in its results within the grace period."""
    original = launcher_protocol.Endings._ask_to_stop

    def forget(self: launcher_protocol.Endings, since: float) -> bool:
        problem = self._stop.problem
        over = original(self, since)
        self._stop.problem = problem
        return over

    patch.setattr(launcher_protocol.Endings, "_ask_to_stop", forget)


#: Schedules of a world among which each of PLANTS is found.
ENOUGH_SEEDS = 400

#: The plants that are found soon, with the worlds of `small_worlds` in which each is looked for. The others need a rare
#: schedule; one for each is in test_found_schedules.
PLANTS: dict[Plant, tuple[str, ...]] = {
    counts_go_on_at_a_join: ("steps",),
    early_messages_are_delivered_twice: ("realtime",),
    early_messages_are_lost: ("realtime",),
    a_new_process_handles_what_was_sent_before_it_joined: ("lockstep",),
    the_stamp_is_of_an_older_step: ("lockstep",),
    the_epoch_of_the_stamp_is_old: ("steps",),
    counts_of_an_older_epoch_are_taken: ("lockstep", "steps"),
    a_stall_is_taken_for_an_end: ("lockstep",),
    the_stop_overtakes_the_last_frame: ("lockstep",),
    the_next_frame_waits_for_no_node: ("lockstep",),
    listeners_are_not_waited_for_at_the_end: ("lockstep",),
    listeners_are_not_waited_for_before_a_change: ("lockstep",),
    a_dead_node_is_waited_for: ("lockstep",),
    a_node_that_returns_at_once_is_not_noticed: ("lockstep",),
    publishers_do_not_wait_for_subscribers: ("lockstep",),
    a_wiring_change_reaches_one_side_only: ("lockstep",),
    the_wiring_changes_before_all_are_ready: ("realtime",),
    a_drain_ends_early: ("realtime",),
    messages_are_not_held_back: ("realtime",),
    held_back_messages_are_lost: ("realtime",),
    all_nodes_begin_with_the_planned_wiring: ("lockstep",),
    dropped_messages_are_not_counted: ("lockstep",),
    a_node_reports_before_it_has_handled: ("lockstep",),
    a_stop_signal_waits_for_no_results: ("lockstep",),
    a_node_that_may_end_ends_the_run: ("lockstep",),
    another_node_is_told_as_lost: ("lockstep",),
    the_last_exit_is_not_handled: ("lockstep",),
    a_death_is_taken_for_an_end: ("lockstep",),
    losses_are_not_told: ("lockstep",),
    steps_do_not_wait_for_a_quiet_mesh: ("steps",),
    an_end_is_believed_of_any_reason: ("lockstep",),
}
