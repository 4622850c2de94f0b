"""A library that is missing, and where to get it. The project is on no package index."""

from __future__ import annotations

from importlib.util import find_spec

from schemas.exit_codes import CommandError


def missing_extra(library: str, extra: str) -> CommandError:
    """Return the error that ``library`` is missing, which this extra of the package brings."""
    return CommandError(f"this needs {library}{how_to_get(extra)}")


def how_to_get(extra: str) -> str:
    """Return where an extra comes from, to be put behind what needs it."""
    if find_spec("pip") is not None:
        return f": pip install -e '.[{extra}]' in the checkout, or 'FILE[{extra}]' with the wheel"
    # The Debian package and the image have none: what they bring is all that they ever have.
    return (
        ", which is not part of this installation, and there is no pip: run it from a checkout, where "
        "'make install' brings it"
    )
