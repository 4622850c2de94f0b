"""A report of a drive, for people: one page that needs no network.

- ``series``      numbers over time, reduced while they stream in, so that spikes survive
- ``spans``       what was so from when to when
- ``odometry``    the way from speeds, and the path from speeds and steering angles
- ``account``     all of one robot, from its rows
- ``drives``      when it was commanded or moved, between long rests
- ``event_log``   what happened to it, from the entries of the timeline
- ``versions``    which gateways it had, and what was otherwise
- ``margins``     what a log says besides its messages
- ``findings``    what the report says, as data
- ``survey``      reads logs, and finds it
- ``words``       the summary in plain words
- ``figures``     the charts, as data
- ``markup``      pieces of the page, in which all of a log is escaped
- ``links``       the ways through the page
- ``overview``    its beginning, where there are several drives
- ``drive_cards`` a drive on it
- ``page``        the HTML page; ``page.js`` draws and plays it
"""
