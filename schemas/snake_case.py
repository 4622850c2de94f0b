"""CamelCase, as the DBC and Python's classes have it, to snake_case, as fields have it."""

from __future__ import annotations

import re


def snake_case(text: str) -> str:
    """``RearLeftSpeed`` to ``rear_left_speed``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text).lower()
