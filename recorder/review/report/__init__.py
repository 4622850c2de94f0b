"""A report of a drive, for people: one page that needs no network.

- ``survey``    reads logs, once
- ``account``   all of one robot, from its messages
- ``charts``    lines, bands and path, reduced while the samples stream in
- ``versions``  its gateways, and their configurations
- ``findings``  what the report says, as data
- ``words``     the verdict, and the lines below it
- ``figures``   the charts as data for ``page.js``
- ``page``      the HTML page; ``page.js`` draws and plays it
"""
