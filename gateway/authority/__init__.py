"""Authority over this robot, and the proof of its own messages. Pure: files, clocks and Zenoh are elsewhere.

A request comes with its attachment; ``admission`` finds out who sent it and what that person may do, and passes it
on with a verdict, by which the core refuses. Core and journal never see a key. ``robot_authority`` holds what is
believed, and the newest time in any verified statement; ``operator_proof`` is the operator's end, ``session`` what
both ends know: the key of a lease, and signatures by it. ``enrolment`` lets machines and people in.
"""
