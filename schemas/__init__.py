"""Messages, requests, keys and encodings of the wire. Knows no other package of ours.

Pure: no I/O, no clock, but for ``zenoh_session``, and for generators, which write files.

- ``messages``  the typed messages, with units in their names; ``decisions`` those of the arbiter, and its replies
- ``requests``  what may be asked of a robot, untrusted; ``reasons`` why it is refused, or the robot stopped
- ``recording``, ``journal``  what a recorder says; what a core's inputs say
- ``subjects``  the one table of subjects: key, type, quality of service, rate, origin; and that of the verbs
- ``keys``      building and parsing Zenoh keys
- ``codec``     MessagePack, and the encoding string that names a schema
- ``can_word``  the words that describe a CAN frame; ``cruiser`` the Cruiser's figures and its DBC files
- ``settings``  every setting and limit, with unit and bounds; ``configuration`` merges its sources
- ``command_line``, ``arguments``  what command lines share: how a command ends, text that is safe to print
- ``authority`` who may say it; ``peers`` how often
- ``zenoh_session`` the Zenoh session that every process opens

``cruiser-coarse.dbc`` and ``cruiser-fine.dbc`` are the one source of the chassis's bits, scales, units and
cycle times. ``json/`` holds a JSON Schema for each of them, which ``json_schema`` generates.
"""
