"""Messages, requests, keys and encodings on Zenoh; imports no other package of the project.

Pure, without I/O or clock, except for ``zenoh_session`` and for generators, which write files.

- ``messages``  the typed messages, with units in their names; ``decisions`` those of the arbiter, and its replies
- ``requests``  requests to a robot, untrusted; ``reasons`` of refusals and stops
- ``recording``, ``journal``  messages of a recorder; inputs of the gateway's core
- ``subjects``  the table of subjects (key, type, quality of service, rate) and that of the verbs
- ``keys``      building and parsing Zenoh keys
- ``codec``     MessagePack, and the encoding that names a schema
- ``can_word``  flags of CAN frames; ``cruiser`` the Cruiser's figures and its DBC files
- ``settings``  every setting and limit, with unit and bounds; ``configuration`` merges their sources
- ``command_line``, ``arguments``  exit codes, errors, printable text and options of all commands
- ``authority`` signatures and grants; ``peers`` limits on a server's clients
- ``zenoh_session`` the Zenoh session of every process

``cruiser-coarse.dbc`` and ``cruiser-fine.dbc`` define the chassis's bits, scales, units and cycle times. ``json/``
has a JSON Schema for each message, request and reply, which ``json_schema`` generates.
"""
