"""Layouts of viewers for a log. Pure.

- ``foxglove.json``, ``plotjuggler.xml``  files as Foxglove, Lichtblick and PlotJuggler save them
- ``attached``    these files for a robot, as a recorder attaches them to each log
- ``rerun_blueprint``  a blueprint for rerun; it needs rerun's package
"""
