"""Time of a CPM with 20 objects, and ratio to asn1tools.

    python benchmarks/v2x.py [--seconds 10]

| line | what is measured |
|---|---|
| tracks to columns, columns to tracks | quantisation, classes and confidences of 20 tracks |
| encode, decode | columns of integers to bytes and back; the budget is 0.1 ms each |
| asn1tools | the container of the objects alone, from and to its own Python values; needs $MAST_DATA/etsi_asn1 |

All are measured in turn until the time is up; the least and the median are printed, as other processes only add time.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mast_zenoh import kernels
from mast_zenoh.arrays.states import CLASSES, ObjectStates
from mast_zenoh.v2x import cpm
from mast_zenoh.v2x.asn1.uper import to_plain
from mast_zenoh.v2x.reference_position import LocalPlane
from mast_zenoh.v2x.tracks import from_cpm, to_cpm, to_objects

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
OBJECTS, CALLS = 20, 20
BUDGET_MS = 0.1


def measured() -> tuple[bytes, dict[str, Callable[[], object]]]:
    """A message, and what is measured of it, by name."""
    random, plane = np.random.default_rng(0), LocalPlane()
    tracks = ObjectStates.of(
        random.uniform(-100, 100, (OBJECTS, 3)),
        velocity=random.uniform(-20, 20, (OBJECTS, 3)),
        size=random.uniform(0.5, 5, (OBJECTS, 3)),
        covariance=np.tile(0.1 * np.eye(9), (OBJECTS, 1, 1)),
        class_id=random.integers(0, len(CLASSES), OBJECTS).astype(np.uint8),
    )
    ids, position = np.arange(OBJECTS), plane.to_position(np.zeros(3))
    reference = plane.to_point(position)
    message = to_cpm(to_objects(tracks, ids, reference), 7, 690_000_000_000, position, yaw=0.0)
    data = cpm.encode(message)
    received = cpm.decode(data)
    return data, {
        "tracks to columns": lambda: to_objects(tracks, ids, reference),
        "encode": lambda: cpm.encode(message),
        "decode": lambda: cpm.decode(data),
        "columns to tracks": lambda: from_cpm(received, plane),
    }


def peers(data: bytes) -> dict[str, Callable[[], object]]:
    """asn1tools with the same message, if it and the ASN.1 modules are there."""
    try:
        import asn1_oracle
    except ImportError:
        return {}
    if not asn1_oracle.FOLDER.is_dir():
        return {}
    layout = cpm.LAYOUT
    plain = to_plain(layout, cpm.to_values(cpm.decode(data)))
    assert asn1_oracle.encode("CPM", layout.type, plain) == data
    codec = asn1_oracle.specification("CPM")
    name, container = "PerceivedObjectContainer", plain["payload"]["cpmContainers"][-1]["containerData"]
    values = asn1_oracle.to_asn1tools("CPM", cpm.PerceivedObjectContainer, container)
    encoded = codec.encode(name, values)
    return {
        "asn1tools: encode": lambda: codec.encode(name, values),
        "asn1tools: decode": lambda: codec.decode(name, encoded),
    }


def main() -> None:
    """Measure until the time is up, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()
    data, calls = measured()
    calls |= peers(data)
    times: dict[str, list[float]] = defaultdict(list)
    end = time.monotonic() + arguments.seconds
    while time.monotonic() < end:
        for name, call in calls.items():
            begin = time.process_time_ns()
            for _ in range(CALLS):
                call()
            times[name].append((time.process_time_ns() - begin) * 1e-6 / CALLS)
    print(f"{OBJECTS} objects, {len(data)} bytes, {kernels.USED} kernels; ms")
    print(f"{'':24}{'least':>8}{'median':>8}")
    for name, values in times.items():
        budget = f"  budget {BUDGET_MS}" if name in ("encode", "decode") else ""
        print(f"{name:24}{min(values):8.3f}{statistics.median(values):8.3f}{budget}")
    for name in ("encode", "decode"):
        if f"asn1tools: {name}" in times:
            print(f"asn1tools takes {min(times[f'asn1tools: {name}']) / min(times[name]):.0f} times as long to {name}")


if __name__ == "__main__":
    main()
