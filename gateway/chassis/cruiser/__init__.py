"""The Cruiser alone: its frames, its two firmware variants, plausible values, and the gate's table.

A second chassis is a folder beside this one. It would take more than that: a DBC, messages and subjects of its own
in ``schemas`` (with its figures, as ``schemas.cruiser``), a tracker in ``gateway.telemetry`` and a view in
``gateway.guard`` that read its messages, the gate's rules where it has other frames than the five of a burst, and a
choice of the chassis in the settings. The arbiter, the stop sequence and the guard know it only as ``ChassisState``
and ``Actuation``; they need new limits, not new code.
"""
