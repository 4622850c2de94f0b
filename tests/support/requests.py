"""A request of each verb, made up."""

from typing import Final

from schemas.requests import CHALLENGE_BYTES, Leased
from schemas.subjects import COMMANDS

# Required fields besides the lease.
_OWN: Final[dict[str, dict[str, object]]] = {
    "engage": {"challenge": b"\x01" * CHALLENGE_BYTES},
    "horn": {"on": True},
    "drive": {"seq": 2, "challenge": b"\x01" * CHALLENGE_BYTES, "speed_mps": 0.5, "angle_deg": 1.0},
}
# The verbs that need the lease.
LEASED: Final = [command for command in COMMANDS if issubclass(command.request, Leased)]
# By verb: the fewest fields of a request.
REQUESTS: Final[dict[str, dict[str, object]]] = {
    command.verb: ({"lease": 1} if command in LEASED else {}) | _OWN.get(command.verb, {}) for command in COMMANDS
}
