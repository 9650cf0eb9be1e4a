"""Zenoh's threads keep their Python state between two callbacks."""

import queue
import threading
from contextlib import suppress

import zenoh

from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.mesh.zenoh_process import keeping_state


def test_a_thread_that_receives_has_one_python_state_however_many_samples_it_takes() -> None:
    seen = threading.local()
    first_calls: queue.SimpleQueue[tuple[int, bool]] = queue.SimpleQueue()

    def note(sample: zenoh.Sample) -> None:
        first_calls.put((threading.get_native_id(), not hasattr(seen, "called")))
        seen.called = True

    router, endpoint = open_router()
    with router, open_client(endpoint) as receiver, open_client(endpoint) as sender:
        handler = zenoh.handlers.Callback(keeping_state(note), indirect=False)
        subscriber = receiver.declare_subscriber("samples", handler)
        calls = []
        while len(calls) < 50:
            sender.put("samples", b"")
            with suppress(queue.Empty):  # the first ones may not arrive
                calls.append(first_calls.get(timeout=0.1))
        subscriber.undeclare()
    assert sum(first for _, first in calls) == len({thread for thread, _ in calls})
