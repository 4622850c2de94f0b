"""The Cruiser alone: its frames, its two firmware variants, plausible values, the gate and its table.

- ``frames``      identifiers, layouts (``layouts.json``, made by ``layout_file``), values that can be, the variant
- ``bursts``      the command frames of a tick
- ``gate``        the last look at each frame before the bus
- ``tracker``     feedback as the state that the arbiter sees
- ``guard_view``  the same for the guard
- ``early_stop``  a program of its own: the stop while the computer starts

A second chassis is a folder beside this one, and more than that: a DBC, figures, messages and subjects of its
own in ``schemas``; rules of the gate, where a burst is not these five frames; and a setting that chooses it. The
arbiter and the stop sequence know the chassis as ``ChassisState`` and ``Actuation`` alone, but for the two scales
of speed that plausibility compares.
"""
