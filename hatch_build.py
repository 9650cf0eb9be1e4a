"""Compiles the kernels (`mast_zenoh/kernels/*.pyx`) for a wheel or a checkout.

In an editable install, they are next to their sources.
Without a C compiler, the package is installed without them and uses NumPy instead.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "mast_zenoh/kernels"
#: Beside the kernels: why there are none, empty if there are; `mast doctor` and runs print it.
NOT_COMPILED = "not_compiled.txt"
#: Bit-identical results on every processor: no contraction to fused operations, no native instructions.
#: errno is not used after a square root.
FLAGS = ["-O3", "-g0", "-ffp-contract=off", "-fno-math-errno"]


class Kernels(BuildHookInterface):
    """The build hook of hatch."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; `version` is "standard" or "editable"."""
        root = Path(self.root)
        self._temporary = tempfile.TemporaryDirectory()
        built, reason = compiled(root, Path(self._temporary.name))
        note = Path(self._temporary.name) / NOT_COMPILED
        note.write_text(reason, encoding="utf-8")
        if version == "editable":
            (root / PACKAGE / NOT_COMPILED).write_bytes(note.read_bytes())
            for module in (root / PACKAGE).glob("*.so"):
                module.unlink()  # outdated, or built with a compiler that is no longer there
            for module in built:
                (root / PACKAGE / module.name).write_bytes(module.read_bytes())
        elif built:
            build_data["force_include"].update({str(module): f"{PACKAGE}/{module.name}" for module in built})
            build_data["pure_python"] = False
            build_data["infer_tag"] = True
        else:
            build_data["force_include"][str(note)] = f"{PACKAGE}/{NOT_COMPILED}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder; the wheel holds the compiled modules."""
        self._temporary.cleanup()


def compiled(root: Path, folder: Path) -> tuple[list[Path], str]:
    """Compile the extension modules into `folder`; ([], why) on failure."""
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
    modules = cythonize(extensions, build_dir=str(folder / "c"))  # an error in our sources fails the installation
    command = build_ext(Distribution({"ext_modules": modules}))
    command.build_lib, command.build_temp = str(folder / "lib"), str(folder / "temp")
    command.parallel = True

    def run() -> None:
        command.ensure_finalized()
        with copied_errors(folder / "errors.txt"):
            command.run()

    # In a thread, where nothing is being handled: pip handles an error of its own while it calls us, and what is raised
    # meanwhile would have that as its context instead of the compiler's error.
    with ThreadPoolExecutor(1) as pool:
        error = pool.submit(run).exception()
    if error:  # the types vary if there is no compiler, or no Python header
        errors = folder / "errors.txt"
        reason = why(error, errors.read_text(errors="replace") if errors.exists() else "")
        print(f"kernels not compiled, NumPy will do: {reason}", file=sys.stderr)
        return [], reason
    return [Path(command.get_ext_fullpath(extension.name)) for extension in extensions], ""


def why(error: BaseException, output: str) -> str:
    """Why a compilation failed, in a line: the reason, and the last error that the compiler printed.

    error: of the build;  output: of the compiler
    """
    while error.__cause__ or error.__context__:  # setuptools wraps it, each version in its own way
        error = error.__cause__ or error.__context__  # type: ignore[assignment]
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    if header := next((line for line in errors if "Python.h" in line), ""):
        return f"the headers of Python are missing: {header}"
    if isinstance(error, OSError) and not errors:
        return f"there is no C compiler: {error}"
    if errors:
        return f"the C compiler failed: {errors[-1]}"
    if isinstance(error, subprocess.CalledProcessError):
        return ": ".join([f"the C compiler failed: {error.cmd[0]} returned {error.returncode}", *lines[-1:]])
    return f"the C compiler failed: {error}"


@contextmanager
def copied_errors(file: Path) -> Iterator[None]:
    """Write what this process and those that it starts print to standard error into a file, then print it."""
    sys.stderr.flush()
    kept = os.dup(2)
    with file.open("wb") as stream:
        os.dup2(stream.fileno(), 2)
    try:
        yield
    finally:
        sys.stderr.flush()
        os.dup2(kept, 2)
        os.write(kept, file.read_bytes())
        os.close(kept)
