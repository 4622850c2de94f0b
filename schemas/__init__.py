"""Messages, requests, keys and encodings of the wire. Knows no other package of ours.

Pure: no I/O, no clock, but for ``web``, the server of pages for browsers, and two generators, which write files.

- ``messages``  the typed messages, with units in their names; ``decisions`` those of the arbiter, and its replies
- ``requests``  what may be asked of a robot, untrusted; ``reasons`` why it is refused, or the robot stopped
- ``subjects``  the one table of subjects: key, type, quality of service, rate, origin; and that of the verbs
- ``keys``      building and parsing Zenoh keys
- ``codec``     MessagePack, and the encoding string that names a schema
- ``can_word``  the words that describe a CAN frame; ``dbc_files`` the DBC files' names and text
- ``settings``  every setting and limit, with unit and bounds; ``configuration`` merges its sources, with
  ``setting_table`` and ``toml_text`` behind it
- ``docstrings`` the texts of docstrings, which documents and JSON Schemas repeat
- ``snake_case`` a field's name from the DBC's
- ``printable`` text from outside, made safe for a terminal
- ``zenoh_session`` the one place that configures and opens Zenoh sessions
- ``exit_codes`` how a command ends

``cruiser-coarse.dbc`` and ``cruiser-fine.dbc`` are the one source of the chassis's bits, scales, units and
cycle times. ``json/`` holds a JSON Schema for each of them; ``json_schema`` generates it, and ``documents`` the
tables of ``docs/`` (``make generate``, by ``gateway.documents``, which adds those of the arbiter).
"""
