"""Who may command this robot, and the proof of what it says itself. Pure: files, clocks and Zenoh are elsewhere.

A request comes with its attachment; ``judge`` says who sent it and what that person may do, and gives the core a
verdict. The core and the journal never see a key. ``lease_key`` is what robot and holder share, ``signer`` signs
replies, states and the heads of the chains, ``floor`` is the time as far as it is proven.
"""
