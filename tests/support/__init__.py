"""What tests share: rigs, fakes, makers of logs, and real processes to talk to."""

from pathlib import Path
from typing import Final

SUPPORT: Final = Path(__file__).parent
