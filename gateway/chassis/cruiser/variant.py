"""The firmware variant, by the wheel speed frame of a standing robot.

Standing still, it reads about 200 raw in the coarse variant and about 32768 in the fine one; read in the wrong
variant a standing robot shows -8 m/s or -32.6 m/s (protocol notes, 'Two firmware variants').
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from gateway.chassis.cruiser.frames import WHEEL_SPEED
from gateway.chassis.cruiser.layout import load
from gateway.chassis.decode import Signals, compile_signals
from gateway.chassis.faults import FaultKind
from gateway.chassis.layout import MessageLayout
from schemas.messages import Variant
from schemas.settings import STANDSTILL_MPS, VARIANT_EVIDENCE_FRAMES

_KNOWN: Final = (Variant.COARSE, Variant.FINE)


def _unused_bits(layout: MessageLayout) -> int:
    used = 0
    for signal in layout.signals:
        used |= ((1 << signal.length) - 1) << signal.start_bit
    return ~used & (1 << 8 * layout.length) - 1


class StandstillEvidence:
    """Evidence of the variant in a wheel speed frame."""

    def __init__(self) -> None:
        layouts = {variant: load(variant).messages[WHEEL_SPEED] for variant in _KNOWN}
        self._readers: dict[Variant, tuple[Callable[[bytes], Signals], int]] = {
            variant: (compile_signals(layout), _unused_bits(layout)) for variant, layout in layouts.items()
        }

    def of(self, data: bytes) -> Variant:
        """The variant in which these eight bytes are those of a standing robot; UNKNOWN if they are not."""
        word = int.from_bytes(data, "little")
        for variant, (read, unused_bits) in self._readers.items():
            signals = read(data)
            stands = all(
                abs(float(signals[wheel])) <= STANDSTILL_MPS for wheel in ("RearLeftSpeed", "RearRightSpeed")
            )
            if signals["Valid"] and stands and not word & unused_bits:
                return variant
        return Variant.UNKNOWN

    def turns(self, data: bytes) -> bool | None:
        """Return True if these eight bytes are of no standing robot in any variant; None if they are not valid."""
        read, _ = self._readers[Variant.COARSE]
        return self.of(data) is Variant.UNKNOWN if read(data)["Valid"] else None


class VariantDetector:
    """Collects evidence until it is enough; afterwards watches for evidence to the contrary.

    Attributes:
        variant: the configured variant, or the one that the evidence confirmed, or UNKNOWN.
        confirmed: the evidence agrees with ``variant``.
        contradicted: the evidence is against it; no speed can be trusted.
        evidence: reads it in a frame.
    """

    def __init__(self, configured: Variant) -> None:
        self._configured = configured
        self.evidence = StandstillEvidence()
        self.reset()

    def reset(self) -> None:
        """Forget the evidence: the bus was away, and another chassis may be on it now."""
        self.variant = self._configured
        self.confirmed = False
        self.contradicted = False
        self._candidate = Variant.UNKNOWN
        self._streak = 0

    def receive_wheel_speed(self, data: bytes) -> FaultKind | None:
        """Take a valid wheel speed frame as evidence. Returns a fault if it speaks for another variant."""
        evidence = self.evidence.of(data)
        self._streak = self._streak + 1 if evidence == self._candidate else 1
        self._candidate = evidence
        if evidence is Variant.UNKNOWN:
            return None
        contrary = self.variant not in {Variant.UNKNOWN, evidence}
        if self._streak >= VARIANT_EVIDENCE_FRAMES:
            if self._configured is Variant.UNKNOWN:
                # Nobody has said which it is, so the evidence decides, also when the chassis has been changed.
                self.variant = evidence
            self.confirmed = evidence == self.variant
            self.contradicted = not self.confirmed
        return FaultKind.VARIANT_CONTRADICTED if contrary else None
