"""Variables that affect floating-point results, besides the versions of packages.

OpenBLAS sums in a different order on other processors, unless its kernels are named. If the launcher's environment
names them, to make results comparable between machines, its nodes get the same variables wherever they run. If the
launcher does not use this package's compiled kernels, its nodes do not either.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from mast_zenoh import kernels

#: Kernels and block sizes; the number of threads is fixed for nodes, and does not affect results.
_VARIABLES = ("OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES")


def environment(launcher_environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The launcher's variables that other hosts need to get the same results."""
    values = {name: launcher_environment[name] for name in _VARIABLES if name in launcher_environment}
    return values | ({"MAST_KERNELS": "numpy"} if kernels.USED == "numpy" else {})
