"""The Cruiser: its frames, its two firmware variants, plausible values, the gate and its table.

- ``frames``      identifiers, layouts (``layouts.json``, made by ``layout_file``), plausible values, the variant
- ``bursts``      the command frames of a tick
- ``gate``        the last look at each frame before the bus
- ``tracker``     feedback as the state that the arbiter sees
- ``guard_view``  the same for the guard
- ``profile``     all of these as one value, the only one that other modules use
- ``early_stop``  a separate program: the stop while the computer starts

A second chassis needs a folder beside this one, and more: see docs/architecture.md, 'A second chassis'.
"""
