"""Authority over this robot, and the proof of its own messages. Pure: files, clocks and Zenoh are elsewhere.

``admission`` checks the attachment of each request and passes the request on with a verdict about its sender; core
and journal never see a key. ``robot_authority`` holds the statements that the robot accepted and its lower bound
of the time. ``operator_proof`` is the operator's end, ``session`` what both ends share: the key of a lease, and
signatures. ``enrolment`` admits machines and people to the network.
"""
