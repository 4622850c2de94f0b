"""Layouts with which viewers open a log: what to plot, and where. Pure.

- ``charts``      what is worth seeing of a robot: the one table that all layouts are made from
- ``foxglove``    for Foxglove and Lichtblick
- ``plotjuggler`` for PlotJuggler
- ``attached``    those that a recorder attaches to each log
- ``rerun``       a blueprint for rerun; it needs rerun's own package
"""
