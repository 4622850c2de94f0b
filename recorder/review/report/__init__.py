"""A report of a drive, for people: one page that needs no network.

- ``gather``    reads logs, once
- ``account``   all of one robot, from its messages; its gateways, and their configurations
- ``findings``  what the report says, as data and in words, with charts reduced while the samples stream in
- ``page``      the HTML page; ``page.js`` draws and plays it
"""
