"""Authority over this robot, and the proof of its own messages. Pure: files, clocks and Zenoh are elsewhere.

A request comes with its attachment; ``admission`` finds out who sent it and what that person may do, and passes it
on with a verdict, by which the core refuses. Core and journal never see a key. Robot and holder share
``lease_key``; ``signer`` signs replies and states; ``floor`` is the newest time in any
verified statement, ``silence`` the time since the last word of the authority.
"""
