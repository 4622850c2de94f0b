"""The Cruiser alone: its frames, its two firmware variants, plausible values, the gate and its table.

- ``frames``      identifiers, layouts (``layouts.json``, made by ``layout_file``), values that can be, the variant
- ``bursts``      the command frames of a tick
- ``gate``        the last look at each frame before the bus
- ``tracker``     feedback as the state that the arbiter sees
- ``guard_view``  the same for the guard
- ``profile``     all of these as one value, by which everybody else knows them
- ``early_stop``  a program of its own: the stop while the computer starts

A second chassis is a folder beside this one, and more than that: see docs/architecture.md, 'A second chassis'.
"""
