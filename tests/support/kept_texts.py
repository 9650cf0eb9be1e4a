"""Texts that are kept in files: what pages and tables say, word by word."""

from __future__ import annotations

import html
import io
import os
import re
from pathlib import Path

from rich.console import Console, RenderableType

WORDS = Path(__file__).parents[1] / "words"


def assert_kept(name: str, *texts: str) -> None:
    """Assert that texts are those of tests/words/NAME.txt. MAST_KEEP_TEXTS=1 writes that file instead, for a review."""
    text = "\n".join([*map(str.rstrip, "\n".join(texts).splitlines()), ""])
    if os.environ.get("MAST_KEEP_TEXTS"):
        (WORDS / f"{name}.txt").write_text(text, "utf-8")
    assert text == (WORDS / f"{name}.txt").read_text("utf-8")


def printed(*things: RenderableType) -> str:
    """What a terminal of 80 columns shows."""
    console = Console(file=io.StringIO(), width=80)
    for each in things:
        console.print(each)
    return console.file.getvalue()


def visible(page: Path) -> str:
    """What a reader of a page sees, a line for each paragraph and row, without pictures, scripts and markup."""
    text = re.sub(r"<(script|style|svg)\b.*?</\1>|\n", " ", page.read_text("utf-8"), flags=re.DOTALL)
    text = re.sub(r"</(?:p|tr|h\d|li|div|pre|details|summary|caption|figcaption|title)>", "\n", text)
    text = html.unescape(re.sub(r"<[^>]+>", "", re.sub(r"</t[dh]>", " | ", text)))
    text = re.sub(r"Made by mast-zenoh \S+", "", text.replace(str(page.parent), "RUN"))
    return "\n".join(filter(None, (" ".join(line.split()) for line in text.splitlines())))
