"use strict";
// Draws the charts in the colours of the page, and shows on the map where the robot was at the time under the pointer.
(function () {
  const robots = JSON.parse(document.getElementById("charts").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const phone = window.matchMedia("(max-width: 40rem)");
  const drawn = [];

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(name).trim();
    return { ink: of("--ink"), soft: of("--soft"), grid: of("--grid"), card: of("--card"), line: of("--line") };
  }

  function dressed(layout) {
    const now = colours();
    const dress = {
      ...layout,
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, color: now.ink, size: 12 },
      hoverlabel: { bgcolor: now.card, bordercolor: now.line, font: { color: now.ink }, align: "left", namelength: -1 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: now.soft, activecolor: now.ink },
      dragmode: phone.matches ? false : "zoom",
    };
    if (document.documentElement.hasAttribute("data-printing")) { dress.width = 660; dress.autosize = false; }
    for (const name of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(name)) {
        dress[name] = { ...layout[name], gridcolor: now.grid, zerolinecolor: now.line, linecolor: now.line,
          tickcolor: now.line, spikecolor: now.soft, nticks: phone.matches && layout[name].type === "date" ? 4 : 0 };
      }
    }
    return dress;
  }

  // Paper is white, and as wide as A4; the browser lays it out only when this is over.
  function print(begins) {
    document.documentElement.toggleAttribute("data-printing", begins);
    dressAgain();
  }

  function options() {
    return { responsive: true, displaylogo: false, displayModeBar: phone.matches ? false : "hover",
      modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"], scrollZoom: false };
  }

  function draw(element, figure) {
    drawn.push({ element, figure });
    return Plotly.newPlot(element, figure.data, dressed(figure.layout), options());
  }

  function dressAgain() {
    for (const { element, figure } of drawn) {
      // What was zoomed in on stays.
      const layout = dressed(figure.layout);
      for (const name of Object.keys(figure.layout)) {
        const axis = element.layout[name];
        if (/^[xy]axis\d*$/.test(name) && axis && axis.range && axis.autorange === false) {
          layout[name] = { ...layout[name], range: axis.range.slice(), autorange: false };
        }
      }
      Plotly.react(element, element.data, layout, options());
    }
  }

  // The newest place that is not after the time.
  function placeAt(places, timeMs) {
    let low = 0, high = places.time_ms.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (places.time_ms[middle] <= timeMs) { low = middle + 1; } else { high = middle; }
    }
    return Math.max(0, low - 1);
  }

  function link(time, map, places) {
    const here = map.data.length - 1;
    if (!places.time_ms.length) { return; }
    const show = (x, y) => Plotly.restyle(map, { x: [x], y: [y] }, [here]);
    const hold = () => {
      // The map keeps still while the mark moves on it.
      const { xaxis, yaxis } = map.layout;
      if (xaxis.autorange !== false || yaxis.autorange !== false) {
        Plotly.relayout(map, { "xaxis.range": xaxis.range.slice(), "yaxis.range": yaxis.range.slice() });
      }
    };
    time.on("plotly_hover", (event) => {
      const at = event.xvals && event.xvals.length ? event.xvals[0] : event.points[0].x;
      const timeMs = typeof at === "number" ? at : Date.parse(String(at).replace(" ", "T") + "Z");
      const number = placeAt(places, timeMs);
      hold();
      show([places.x_m[number]], [places.y_m[number]]);
    });
    time.on("plotly_unhover", () => show([], []));
  }

  const ready = robots.map(async (robot, number) => {
    const map = document.getElementById("map-" + number);
    const time = document.getElementById("time-" + number);
    await draw(map, robot.map);
    await draw(time, robot.time);
    link(time, map, robot.places);
  });
  Promise.all(ready).then(() => { document.documentElement.dataset.drawn = String(drawn.length); });
  dark.addEventListener("change", dressAgain);
  phone.addEventListener("change", dressAgain);
  window.addEventListener("beforeprint", () => { print(true); });
  window.addEventListener("afterprint", () => { print(false); });
})();
