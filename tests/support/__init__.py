"""What tests share.

A message or a sample: ``messages``, or any by Hypothesis: ``strategies``; the frames of a chassis: ``frames``.
A log: ``logs``, as a recorder writes it, chunk by chunk, and by others; of a made-up drive: ``drives``.
What is in a log: ``reading``, ``columns``.
A core in simulated time: ``rigs``; all that is said there, as a log: ``rigs.recorded``, ``scenarios``, ``day``.
A stand-in with knobs for failures, in memory or on Zenoh: ``fakes``.
A real process or connection: ``processes``. To wait for it: ``waiting``.
"""

from pathlib import Path
from typing import Final

SUPPORT: Final = Path(__file__).parent
