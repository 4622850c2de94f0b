"""The Cruiser alone: its frames, its two firmware variants, plausible values, and the gate's table.

A second chassis is a folder beside this one, and more than that: a DBC, figures, messages and subjects of its
own in ``schemas``; a tracker in ``gateway.telemetry`` and a view in ``gateway.guard`` that read these; rules of
the gate, where a burst is not these five frames; and a setting that chooses it. The arbiter and the stop sequence
know the chassis as ``ChassisState`` and ``Actuation`` alone, but for the two scales of speed that plausibility
compares.
"""
