"""Plays a page of the documentation: writes its files, and runs its commands."""

import os
import re
import subprocess
import sys
from pathlib import Path


def play_page(page: str, folder: Path, least: int) -> Path:
    """Write all files of a page into a folder and run all its commands there, in order; returns the folder.

    Their output is in the file `printed`. least: number of blocks that the page has at least
    """
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    blocks = re.findall(r"^```(console|python file=(\S+))\n(.*?)^```$", page, flags=re.S | re.M)
    assert len(blocks) == len(re.findall(r"^```\w", page, flags=re.M)) >= least, "a block that no test runs"
    for _, file, text in blocks:
        if file:
            (folder / file).write_text(text)
            continue
        for line in text.splitlines():
            assert line.startswith("$ ")
            process = subprocess.run(
                line[2:], shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"
            with (folder / "printed").open("a") as printed:
                printed.write(process.stdout)
    return folder
