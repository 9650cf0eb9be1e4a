"""Compiles the kernels (`mast_zenoh/kernels/*.pyx`) for a wheel or a checkout.

In an editable install, they are next to their sources.
Without a C compiler, the package is installed without them and uses NumPy instead.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "mast_zenoh/kernels"
#: Bit-identical results on every processor: no contraction to fused operations, no native instructions.
#: errno is not used after a square root.
FLAGS = ["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"]


class Kernels(BuildHookInterface):
    """The build hook of hatch."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; `version` is "standard" or "editable"."""
        root = Path(self.root)
        self._temporary = tempfile.TemporaryDirectory()
        built = compiled(root, Path(self._temporary.name))
        if version == "editable":
            for module in (root / PACKAGE).glob("*.so"):
                module.unlink()  # outdated, or built with a compiler that is no longer there
            for module in built:
                (root / PACKAGE / module.name).write_bytes(module.read_bytes())
        elif built:
            build_data["force_include"].update({str(module): f"{PACKAGE}/{module.name}" for module in built})
            build_data["pure_python"] = False
            build_data["infer_tag"] = True

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder; the wheel holds the compiled modules."""
        self._temporary.cleanup()


def compiled(root: Path, folder: Path) -> list[Path]:
    """Compile the extension modules into `folder`; [] on failure."""
    import numpy
    from Cython.Build import cythonize
    from setuptools import Distribution, Extension
    from setuptools.command.build_ext import build_ext

    sys.path.insert(0, str(root / PACKAGE))
    from source_digest import digest  # type: ignore[import-not-found]
    from table_columns import macros as columns  # type: ignore[import-not-found]

    flags = [] if sys.platform == "win32" else FLAGS
    macros = [("SOURCE_DIGEST", f'"{digest()}"'), ("NPY_NO_DEPRECATED_API", "NPY_2_0_API_VERSION"), *columns()]
    names = sorted(path.stem for path in (root / PACKAGE).glob("*.pyx"))
    extensions = [
        Extension(
            f"{PACKAGE.replace('/', '.')}.{name}",
            [f"{PACKAGE}/{name}.pyx"],
            extra_compile_args=flags,
            define_macros=macros,
            include_dirs=[numpy.get_include()],
        )
        for name in names
    ]
    try:
        command = build_ext(Distribution({"ext_modules": cythonize(extensions, build_dir=str(folder / "c"))}))
        command.build_lib, command.build_temp = str(folder / "lib"), str(folder / "temp")
        command.parallel = True
        command.ensure_finalized()
        command.run()
    except Exception as error:  # the types vary if there is no compiler, or no Python header
        print(f"kernels not compiled, NumPy will do: {error}", file=sys.stderr)
        return []
    return [Path(command.get_ext_fullpath(extension.name)) for extension in extensions]
