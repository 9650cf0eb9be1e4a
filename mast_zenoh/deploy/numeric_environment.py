"""What decides over the last digits of what a node computes, besides the versions of what it runs on.

OpenBLAS adds up in another order on another kind of processor, unless its kernels are named. A launcher that names
them, so that results can be compared with those of other machines, means its nodes as well, wherever they live. And
where a launcher has no compiled kernels of ours, its nodes are to do without.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from mast_zenoh import kernels

#: Kernels, block sizes; the number of threads is fixed for nodes, and changes nothing.
_DECIDE = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")


def environment(ours: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The variables of the launcher's environment that nodes elsewhere need, to compute what they would here."""
    named = {name: ours[name] for name in _DECIDE if name in ours}
    return named | ({"MAST_KERNELS": "numpy"} if kernels.USED == "numpy" else {})
