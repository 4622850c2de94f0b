"""A layout for PlotJuggler, which is loaded when the log is.

Its form is that of PlotJuggler's source (``MainWindow::xmlLoadState`` and what that calls). It plots numbers
alone: modes and states are texts to it, and are left out.
"""

from __future__ import annotations

from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from recorder.layouts.charts import ANGLE, LATENESS, LOAD, SPEED, SWITCHES, Chart, Robot

NAME: Final = "layout.plotjuggler.xml"
MEDIA_TYPE: Final = "application/xml"

TABS: Final[dict[str, tuple[Chart, ...]]] = {"drive": (SPEED, ANGLE, SWITCHES), "gateway": (LATENESS, LOAD)}


def plotjuggler_layout(robot: Robot) -> bytes:
    """The layout of a robot's log, as XML."""
    root = Element("root")
    tabs = SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for name, charts in TABS.items():
        tab = SubElement(tabs, "Tab", containers="1", tab_name=name)
        share = f"{1 / len(charts):.6f}"
        splitter = SubElement(
            SubElement(tab, "Container"),
            "DockSplitter",
            orientation="-",
            count=str(len(charts)),
            sizes=";".join([share] * len(charts)),
        )
        for chart in charts:
            _area(splitter, chart, robot)
    SubElement(tabs, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    indent(root, " ")
    text: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _area(splitter: Element, chart: Chart, robot: Robot) -> None:
    area = SubElement(splitter, "DockArea", name=chart.title)
    plot = SubElement(
        area, "plot", mode="TimeSeries", style="Lines", line_width="1.5", flip_x="false", flip_y="false"
    )
    SubElement(plot, "limitY")
    for line in chart.lines:
        SubElement(plot, "curve", name=f"{robot.topic(line.kind)}/{line.field}", color=line.colour)
