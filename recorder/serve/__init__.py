"""The logs of a fleet in a browser: found by their catalog, asked by ``cruiser review``, with notes of people.

- ``library``  the catalog of the directory, kept current, and its answers
- ``answers``  an answer as the page has it
- ``notes``    tags and comments, kept beside the logs
- ``parts``    a part of a log as a file to take away
- ``viewers``  programs that open a log by its address
- ``app``      what browsers may ask for
- ``page``     the page itself
"""
