"""A report of a drive: one page that needs no network.

- ``gather``    reads the logs
- ``account``   one robot, from its messages
- ``findings``  the report as data and in words, with charts reduced while samples stream in
- ``page``      the HTML page; ``page.js`` draws and plays it
"""
