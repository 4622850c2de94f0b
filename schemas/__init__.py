"""What is said, under which key, in which bytes. Pure: no I/O, no clocks, no other package of ours.

- ``messages``  the typed messages, with units in their names
- ``subjects``  the one table of subjects: key, type, quality of service, rate, origin
- ``keys``      building and parsing Zenoh keys
- ``codec``     MessagePack, and the encoding string that names a schema
- ``can_word``  the words that describe a CAN frame; ``dbc_files`` the DBC files' names and text
- ``settings``  every setting and limit, with unit and bounds; ``configuration`` merges its sources, with
  ``setting_table`` and ``toml_text`` behind it
- ``snake_case`` a field's name from the DBC's
- ``printable`` text from outside, made safe for a terminal
- ``zenoh_link`` the Zenoh session settings that every process shares
- ``exit_codes`` how a command ends

``cruiser-coarse.dbc`` and ``cruiser-fine.dbc`` are the one source of the chassis's bits, scales, units and
cycle times. ``json/`` holds the JSON Schema of every subject; ``json_schema`` generates it, and ``documents`` the
tables of the README and of ``docs/`` (``make generate``).
"""
