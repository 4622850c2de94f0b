"""Layouts with which viewers open a log: what to plot, and where. Pure.

- ``foxglove.json``, ``plotjuggler.xml``  files as Foxglove, Lichtblick and PlotJuggler save them
- ``attached``    these for a robot, as a recorder attaches them to each log
- ``rerun_blueprint``  a blueprint for rerun; it needs rerun's own package
"""
