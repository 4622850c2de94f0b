"""What tests share.

- messages and samples: ``messages``, or any by Hypothesis: ``strategies``; frames of a chassis: ``frames``
- logs: ``logs``, as a recorder or others write them; of a made-up drive: ``drives``; their contents: ``reading``
- a core in simulated time: ``rigs``; its log: ``rigs.recorded``, ``scenarios``, ``day``
- stand-ins with knobs for failures, in memory or on Zenoh: ``fakes``
- real processes and connections: ``processes``; waiting for them: ``waiting``
"""

from pathlib import Path
from typing import Final

SUPPORT: Final = Path(__file__).parent
