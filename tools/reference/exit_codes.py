"""docs/ref-exit-codes.md: what each exit code of `mast` means."""

from __future__ import annotations

from mast_zenoh import errors
from reference import page, table
from reference.command_line import own_exit_codes

_AFTER = """\
[explanation-architecture.md](explanation-architecture.md#how-a-run-ends) says how runs end, and with which status.
"""


def exit_codes_page() -> str:
    """The exit codes of all errors."""
    rows = [(error.exit_code, f"`{error.__name__}`", first_line(error)) for error in error_types()]
    rows += [(0, "", "Success"), (2, "", "Usage error")]
    codes = table(("code", "error", "meaning"), ((str(code), *words) for code, *words in sorted(rows)))
    introduction = (
        "Look up what a command's exit code means. [troubleshooting.md](troubleshooting.md) explains what to do."
    )
    own = "".join(f"- `{command}` {words[0].lower()}{words[1:]}\n" for command, words in own_exit_codes())
    sections = [codes, "Commands with codes of their own:\n", own, _AFTER]
    return page("Exit codes", "mast_zenoh/errors.py", introduction, sections)


def error_types(base: type[errors.MastError] = errors.MastError) -> list[type[errors.MastError]]:
    """The whole error tree."""
    return [base, *(error for child in base.__subclasses__() for error in error_types(child))]


def first_line(of: type) -> str:
    """The first line of a docstring, without its full stop."""
    return (of.__doc__ or "").strip().splitlines()[0].rstrip(".")
