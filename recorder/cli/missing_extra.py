"""A library that is missing, and where to get it."""

from __future__ import annotations

from importlib.util import find_spec

from schemas.exit_codes import CommandError


def missing_extra(library: str, extra: str) -> CommandError:
    """Return the error that ``library`` is missing, which this extra of the package brings."""
    if find_spec("pip") is not None:
        return CommandError(f"this needs {library}: pip install 'cruiser-gateway[{extra}]'")
    # The Debian package and the image have none: what they bring is all that they ever have.
    return CommandError(
        f"this needs {library}, which is not part of this installation, and there is no pip: "
        "run it from a checkout, where 'make install' brings it"
    )
