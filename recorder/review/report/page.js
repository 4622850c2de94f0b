"use strict";
// Draws the charts in the page's colours, plays the drives, and shows the moment of the address:
// report.html#t=2026-01-02T03:04:05.678Z, with &robot=NAME if there are several.
(function () {
  const { drives } = JSON.parse(document.getElementById("charts").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const phone = window.matchMedia("(max-width: 40rem)");
  const note = document.getElementById("note");
  let drawn = 0;
  const EAGER = 4; // further drives are drawn when they scroll near
  const REACH_MS = 2000; // between two places further apart in time the robot stood, and left the first one this long before the second
  const SILENT_MS = 500; // an older value is not shown
  const WRITE_MS = 500; // browsers reject an address that changes too often
  const OUTLINE_M = [[0.75, 0.3], [0.9, 0], [0.75, -0.3], [-0.15, -0.3], [-0.15, 0.3]]; // from the rear axle, as on the desk
  const OUTLINE_PX = 26; // minimum size; below it the outline is not to scale
  const STEP_MS = { ArrowLeft: -1000, ArrowDown: -1000, ArrowRight: 1000, ArrowUp: 1000, PageUp: 10000, PageDown: -10000 };
  const [LEFT, RIGHT, BOTTOM, ROW] = [58, 12, 44, 30]; // pixels around the drawing, and the height of a band's row
  const CHARTS = [{ name: "speed, m/s", unit: " m/s", digits: 2 }, { name: "angle, deg", unit: "°", digits: 1 }];
  const ZOOM_MS = 20; // the shortest time that fills the charts
  const ZOOM_M = 0.5; // the shortest distance that fills the map
  const DRAG_PX = 4; // a shorter drag is a click
  const MARGIN = 0.02; // the share of its time that is added at both ends

  const [BLUE, ORANGE, GREEN, RED] = ["#3987e5", "#e08a1e", "#199e70", "#e0524d"];
  const [VIOLET, GREY, OLIVE] = ["#9085e9", "#8a8f98", "#b5a000"];
  const COLOURS = { auto: GREEN, remote: VIOLET, stop: GREY, standby: GREY, engaging: OLIVE, engaged: GREEN, stopping: RED };
  const PALETTE = [BLUE, ORANGE, VIOLET, OLIVE, GREEN]; // for other values of a band, in turn
  const [SQUARE, DIAMOND, CIRCLE] = ["M-1-1H1V1H-1Z", "M0-1 1 0 0 1-1 0Z", "M-1 0A1 1 0 1 1 1 0 1 1 0 1 1-1 0Z"];
  const [OPEN, ON_MAP] = [{ is_open: true }, { is_on_map: true }]; // only the outline is drawn; it is also shown on the path
  const look = (path, colour, ...more) => Object.assign({ path, colour, radius: 5.5 }, ...more);
  const MARKS = { // shapes differ too, for people who cannot distinguish colours
    stop: look(SQUARE, RED, ON_MAP),
    latch: look(DIAMOND, RED, OPEN, ON_MAP, { radius: 10 }), // drawn around the stop that it comes with
    fault: look("M-1-1 1 1M1-1-1 1", ORANGE, OPEN, ON_MAP),
    guard: look("M0-1.2.3-.4 1.2-.4.5.2.7 1.1 0 .6-.7 1.1-.5.2-1.2-.4-.3-.4Z", RED, ON_MAP),
    takeover: look("M0-1 1 1H-1Z", VIOLET, ON_MAP),
    lease: look(CIRCLE, BLUE, OPEN),
    engaged: look(CIRCLE, GREEN),
    stopped: look(SQUARE, GREY, OPEN),
    end: look(SQUARE, GREY),
    reset: look(DIAMOND, BLUE, OPEN),
    gateway: look("M0-1V1M-1 0H1", RED, OPEN, ON_MAP),
    gap: look("M0-1V1", RED, OPEN, ON_MAP),
    clock: look("M0-1.3.6 0 0 1.3-.6 0Z", ORANGE),
    recorder: look("M0-1 1-.2.6 1H-.6L-1-.2Z", GREY, OPEN),
  };
  const ENDS = { begin: look(CIRCLE, GREEN, { radius: 6.5 }), end: look(CIRCLE, GREEN, OPEN, { radius: 6.5 }) }; // of the path
  const BANDS = ["mode", "arbiter", "lease"];
  const [LIMIT, REQUESTED] = [{ name: "limit", colour: GREY, dash: [2, 4] }, { name: "requested", colour: ORANGE, dash: [8, 4] }];
  const [COMMANDED, MEASURED] = [{ name: "commanded", colour: GREEN }, { name: "measured", colour: BLUE, is_straight: true }];
  const LINES = [ // a value holds until the next one, except measured ones; the steering limit is for both sides
    ...[LIMIT, REQUESTED, COMMANDED, MEASURED].map((line) => ({ ...line, chart: 0 })),
    ...[{ ...LIMIT, is_mirrored: true }, REQUESTED, COMMANDED, MEASURED].map((line) => ({ ...line, chart: 1 })),
  ];

  const colourOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const isPrinting = () => document.documentElement.hasAttribute("data-printing");

  function svg(name, attributes = {}, parent = null, text = "") {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) { element.setAttribute(key, value); }
    if (text) { element.textContent = text; }
    if (parent) { parent.append(element); }
    return element;
  }

  function html(name, kind, parent) {
    const element = document.createElement(name);
    element.className = kind;
    parent.append(element);
    return element;
  }

  // An event as a symbol, with its text as a tooltip.
  function markOf(look, x, y, text, parent) {
    const mark = svg("path", { d: look.path, class: "mark", stroke: look.colour, fill: look.is_open ? "none" : look.colour,
      transform: `translate(${x.toFixed(1)},${y.toFixed(1)}) scale(${look.radius})`, "pointer-events": "all" }, parent);
    svg("title", {}, mark, text);
    return mark;
  }

  function explain(element, kinds) {
    for (const [kind, look] of kinds) {
      const item = html("li", "", element);
      const picture = svg("svg", { width: 22, height: 22, "aria-hidden": "true" }, item);
      markOf(look, 11, 11, "", picture);
      item.append(kind);
    }
  }

  // Paper is white and as wide as A4; the browser does its layout after this.
  function print(begins) {
    document.documentElement.toggleAttribute("data-printing", begins);
    if (begins) { all.forEach((drive) => drive.draw()); }
    dressAgain();
  }

  function dressAgain() { all.forEach((drive) => drive.dress()); }

  const widthOf = (element) => (isPrinting() ? 660 : element.clientWidth);

  // No minus before zero.
  const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]+$)/, "");
  const isoOf = (timeMs) => new Date(Math.round(timeMs)).toISOString();
  const clockOf = (timeMs) => isoOf(timeMs).slice(11, 23);

  // Times from their differences.
  function sums(steps) {
    let sum = 0;
    return steps.map((step) => (sum += step));
  }

  // The index of the last one up to the time; -1 if there is none.
  function newest(times, timeMs) {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= timeMs) { low = middle + 1; } else { high = middle; }
    }
    return low - 1;
  }

  // A player begins with the first message, which may not be a sample.
  const reached = (firstMs, timeMs) => (firstMs - timeMs <= SILENT_MS ? Math.max(firstMs, timeMs) : timeMs);

  // A line by its samples and its breaks.
  function lineOf([times, values]) {
    return (askedMs) => {
      const timeMs = reached(times[0], askedMs);
      let at = newest(times, timeMs);
      const breaks = at === times.length - 1 || values[at] === null;
      if (values[at] === null) { at -= 1; }
      return at < 0 || (breaks && timeMs - times[at] > SILENT_MS) ? null : values[at];
    };
  }

  function bandOf(spans) {
    const firstMs = spans.reduce((first, [fromMs]) => Math.min(first, fromMs), Infinity);
    return (askedMs) => {
      const timeMs = reached(firstMs, askedMs);
      const span = spans.find(([fromMs, toMs]) => fromMs <= timeMs && timeMs <= toMs);
      return span ? span[2] : "";
    };
  }

  // Round steps, far enough apart for their numbers.
  function ticks(from, to, pixels) {
    const raw = ((to - from) * 80) / pixels, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((one) => one * power >= raw);
    const found = [];
    for (let number = Math.ceil(from / step); number * step <= to; number += 1) { found.push(number * step); }
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  // Follows the mouse from a press, and reports at the end whether it was a drag. A finger scrolls the page.
  function drag(begin, moved, ended) {
    const [x, y] = [begin.clientX, begin.clientY];
    let isDrag = false;
    const move = (event) => {
      isDrag = isDrag || Math.hypot(event.clientX - x, event.clientY - y) > DRAG_PX;
      if (isDrag) { moved(event.clientX - x, event.clientY - y); }
    };
    const up = (event) => {
      document.removeEventListener("mousemove", move);
      document.removeEventListener("mouseup", up);
      ended(event.clientX - x, event.clientY - y, isDrag);
    };
    document.addEventListener("mousemove", move);
    document.addEventListener("mouseup", up);
    begin.preventDefault();
  }

  // The path of a drive: a map in metres, with equal scales.
  class PathMap {
    constructor(element, drive) {
      this.element = element;
      this.drive = drive;
      const { x_m: xs, y_m: ys, begins } = drive.path;
      this.marks = drive.figures.moments.filter(({ at, kind }) => at && MARKS[kind] && MARKS[kind].is_on_map)
        .map(({ at, kind, text, ms }) => ({ at, look: MARKS[kind], text, ms, kind }));
      if (xs.length) {
        const last = xs.length - 1;
        [["end", last], ["begin", 0]].forEach(([name, at]) => this.marks.unshift({ at: [xs[at], ys[at]], look: ENDS[name],
          text: `${name} ${clockOf(drive.path.time_ms[at])}`, ms: drive.path.time_ms[at], kind: name + " of the path" }));
      }
      const starts = new Set(begins);
      this.way = xs.map((x, at) => `${at === 0 || starts.has(at) ? "M" : "L"}${x} ${ys[at]}`).join("");
      this.root = svg("svg", { class: "plot" }, element);
      const list = html("ul", "marks", element);
      explain(list, new Map(this.marks.map(({ kind, look }) => [kind, look])));
      this.root.addEventListener("mousedown", (event) => this.press(event));
      this.root.addEventListener("dblclick", () => { this.view = null; this.draw(); });
      this.root.addEventListener("mousemove", (event) => this.point(event));
      this.root.addEventListener("mouseleave", () => this.point(null));
    }

    // The whole path with a margin.
    whole() {
      const points = [...this.drive.path.x_m.map((x, at) => [x, this.drive.path.y_m[at]]), ...this.marks.map(({ at }) => at)];
      const [low, high] = [Math.min, Math.max].map((of) => [0, 1].map((axis) => points.reduce((best, one) => of(best, one[axis]),
        points.length ? points[0][axis] : 0)));
      const [width, height] = [0, 1].map((axis) => Math.max(1.1 * (high[axis] - low[axis]), 2));
      return { x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2, width, height };
    }

    place(xM, yM) {
      return [this.left + (xM - this.view.x) * this.scale, this.top - (yM - this.view.y) * this.scale];
    }

    metres(event) {
      const box = this.root.getBoundingClientRect();
      return [(event.clientX - box.left - this.left) / this.scale + this.view.x, (this.top - event.clientY + box.top) / this.scale + this.view.y];
    }

    draw() {
      const [width, height] = [widthOf(this.element), phone.matches && !isPrinting() ? 320 : 400];
      this.field = { x: LEFT, y: 8, width: Math.max(10, width - LEFT - RIGHT), height: height - BOTTOM - 8 };
      this.view = this.view || this.whole();
      this.scale = Math.min(this.field.width / this.view.width, this.field.height / this.view.height);
      [this.left, this.top] = [LEFT + this.field.width / 2, 8 + this.field.height / 2];
      const { field, root } = this;
      root.replaceChildren();
      root.setAttribute("width", width);
      root.setAttribute("height", height);
      const clip = svg("clipPath", { id: `${this.element.id}-clip` }, root);
      svg("rect", field, clip);
      svg("rect", { ...field, class: "field" }, root);
      const [right, bottom] = [field.x + field.width, field.y + field.height];
      for (const axis of [0, 1]) {
        const [pixels, centre] = axis ? [field.height, this.view.y] : [field.width, this.view.x];
        const { found, digits } = ticks(centre - pixels / this.scale / 2, centre + pixels / this.scale / 2, pixels);
        for (const value of found) {
          const [x, y] = this.place(value, value), kind = { class: Math.abs(value) < 1e-9 ? "zero" : "grid" };
          if (axis) { svg("path", { d: `M${field.x},${y}H${right}`, ...kind }, root); }
          else { svg("path", { d: `M${x},${field.y}V${bottom}`, ...kind }, root); }
          const at = axis ? { x: field.x - 6, y: y + 4, "text-anchor": "end" } : { x, y: bottom + 16, "text-anchor": "middle" };
          svg("text", at, root, fixed(value, digits));
        }
      }
      svg("text", { x: field.x + field.width / 2, y: height - 8, "text-anchor": "middle" }, root, "x, m: forward as it stood at first");
      svg("text", { transform: `translate(14,${this.top}) rotate(-90)`, "text-anchor": "middle" }, root, "y, m: left");
      const inside = svg("g", { "clip-path": `url(#${this.element.id}-clip)` }, root);
      const [x0, y0] = this.place(0, 0);
      svg("path", { d: this.way, class: "way", stroke: BLUE, transform: `matrix(${this.scale},0,0,${-this.scale},${x0},${y0})` }, inside);
      for (const { at, look, text, ms } of this.marks) {
        markOf(look, ...this.place(...at), text, inside).dataset.ms = ms;
      }
      this.said = svg("text", { x: right - 4, y: field.y + 14, "text-anchor": "end" }, root);
    }

    // The place of the path nearest to the pointer.
    nearest(event) {
      const [x, y] = this.metres(event), { x_m: xs, y_m: ys } = this.drive.path;
      let best = -1, least = Infinity;
      for (let at = 0; at < xs.length; at += 1) {
        const away = Math.hypot(xs[at] - x, ys[at] - y);
        if (away < least) { [best, least] = [at, away]; }
      }
      return best;
    }

    point(event) {
      const at = event ? this.nearest(event) : -1, { time_ms: times, x_m: xs, y_m: ys } = this.drive.path;
      if (this.said) { this.said.textContent = at < 0 ? "" : `${clockOf(times[at])}  x ${fixed(xs[at], 2)} m, y ${fixed(ys[at], 2)} m`; }
      this.drive.hover(at < 0 ? null : times[at]);
    }

    press(event) {
      if (event.button !== 0) { return; }
      const before = { ...this.view }, box = event.shiftKey ? null : svg("rect", { class: "box" }, this.root);
      const from = this.root.getBoundingClientRect(), [x, y] = [event.clientX - from.left, event.clientY - from.top];
      const area = (dx, dy) => ({ x: Math.min(x, x + dx), y: Math.min(y, y + dy), width: Math.abs(dx), height: Math.abs(dy) });
      drag(event, (dx, dy) => {
        if (box) {
          for (const [name, value] of Object.entries(area(dx, dy))) { box.setAttribute(name, value); }
          return;
        }
        this.view = { ...before, x: before.x - dx / this.scale, y: before.y + dy / this.scale };
        this.draw();
        this.drive.mark();
      }, (dx, dy, isDrag) => {
        if (!isDrag) {
          if (box) { box.remove(); }
          const at = this.nearest(event), mark = event.target.closest("[data-ms]");
          if (mark || at >= 0) { this.drive.choose(mark ? Number(mark.dataset.ms) : this.drive.path.time_ms[at]); }
        } else if (box) {
          const { x: left, y: top, width, height } = area(dx, dy);
          this.view = { x: this.view.x + (left + width / 2 - this.left) / this.scale, y: this.view.y - (top + height / 2 - this.top) / this.scale,
            width: Math.max(width / this.scale, ZOOM_M), height: Math.max(height / this.scale, ZOOM_M) };
          this.draw();
          this.drive.mark();
        }
      });
    }
  }

  // Speed, angle, events and bands of a drive over time.
  class TimeCharts {
    constructor(element, drive) {
      this.element = element;
      this.drive = drive;
      this.range = this.whole;
      this.plots = CHARTS.map((_, number) => this.plot(number));
      this.rows = svg("svg", { class: "plot rows", height: (BANDS.length + 1) * ROW }, element);
      const list = html("ul", "marks", element);
      explain(list, new Map(drive.figures.moments.map(({ kind }) => [kind, MARKS[kind]])));
      this.rows.addEventListener("mousedown", (event) => this.pan(event) || drag(event, () => {}, (_x, _y, isDrag) => {
        const mark = event.target.closest("[data-ms]");
        if (!isDrag) { drive.choose(mark ? Number(mark.dataset.ms) : this.timeAt(event)); }
      }));
      this.rows.addEventListener("dblclick", () => this.zoom(...this.whole));
      this.rows.addEventListener("mousemove", (event) => drive.hover(this.timeAt(event)));
      this.rows.addEventListener("mouseleave", () => drive.hover(null));
    }

    plot(number) {
      const { drive } = this, { name, unit, digits } = CHARTS[number];
      const series = [{ label: "UTC", value: (_, ms) => (ms === null ? "--" : clockOf(ms)) }], tables = [];
      LINES.forEach((line, at) => {
        if (line.chart !== number) { return; }
        const [times, values] = drive.lines[at];
        const more = { stroke: line.colour, dash: line.dash, width: line.is_straight ? 2 : 1.5, points: { show: false },
          paths: line.is_straight ? uPlot.paths.linear() : uPlot.paths.stepped({ align: 1 }) };
        series.push({ ...more, label: line.name, value: (_, value) => (value === null || value === undefined ? "--" : fixed(value, digits) + unit) });
        tables.push([times, values]);
        if (line.is_mirrored) {
          series.push({ ...more, class: "mirrored" });
          tables.push([times, values.map((value) => (value === null ? null : -value))]);
        }
      });
      const axis = { stroke: () => colourOf("--soft"), grid: { stroke: () => colourOf("--grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
      const plot = new uPlot({
        width: widthOf(this.element), height: number ? 200 : 220, ms: 1, series, padding: [8, RIGHT, 0, 0],
        tzDate: (ms) => uPlot.tzDate(new Date(ms), "Etc/UTC"),
        scales: {
          x: { time: true, min: this.range[0], max: this.range[1], range: () => this.range },
          y: { range: (_, low, high) => (low === null ? [0, 1] : uPlot.rangeNum(Math.min(0, low), Math.max(0, high), 0.1, true)) },
        },
        axes: [
          { ...axis, size: 26, space: (_, _at, fromMs, toMs) => (toMs - fromMs < 10000 ? 96 : 72), values: (_, splits, _at, _space, step) => splits.map((ms) => isoOf(ms).slice(11, step < 1000 ? 23 : step < 60000 ? 19 : 16)) },
          { ...axis, size: LEFT - 18, label: name, labelSize: 18, labelFont: "12px system-ui, sans-serif" },
        ],
        legend: { markers: { width: 2 } },
        cursor: {
          sync: { key: this.element.id }, drag: { x: true, y: false, setScale: false, dist: DRAG_PX }, points: { size: 6 },
          // The newest value of each line, since their times differ.
          dataIdx: (self, at, hovered) => {
            const values = self.data[at];
            let found = hovered;
            while (at && found > 0 && values[found] === undefined) { found -= 1; }
            return found;
          },
          bind: {
            mousedown: (_self, _target, handle) => (event) => { if (!this.pan(event)) { handle(event); } },
            dblclick: () => () => this.zoom(...this.whole),
          },
        },
        hooks: {
          draw: [() => drive.mark()], // the places of the fields are known from here on
          setCursor: [(self) => { if (self.cursor.event) { drive.hover(self.cursor.left < 0 ? null : self.posToVal(self.cursor.left, "x")); } }],
          setSelect: [(self) => {
            const { left, width } = self.select;
            if (width > 0) {
              self.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
              this.zoom(self.posToVal(left, "x"), self.posToVal(left + width, "x"));
            }
          }],
        },
      }, uPlot.join(tables), this.element);
      plot.over.addEventListener("click", (event) => drive.choose(this.timeAt(event)));
      return plot;
    }

    get whole() {
      const room = MARGIN * Math.max(this.drive.toMs - this.drive.fromMs, ZOOM_MS);
      return [this.drive.fromMs - room, this.drive.toMs + room];
    }

    get inner() { return Math.max(10, widthOf(this.element) - LEFT - RIGHT); }

    x(timeMs) { return LEFT + ((timeMs - this.range[0]) / (this.range[1] - this.range[0])) * this.inner; }

    timeAt(event) {
      const left = event.clientX - this.rows.getBoundingClientRect().left - LEFT;
      return this.range[0] + (Math.min(Math.max(left / this.inner, 0), 1)) * (this.range[1] - this.range[0]);
    }

    // With shift, a drag moves the time. Returns true for such a drag.
    pan(event) {
      if (!event.shiftKey || event.button !== 0) { return false; }
      const [from, to] = this.range;
      drag(event, (dx) => {
        const byMs = (-dx / this.inner) * (to - from);
        this.zoom(from + byMs, to + byMs);
      }, () => {});
      return true;
    }

    zoom(fromMs, toMs) {
      const half = Math.max(toMs - fromMs, ZOOM_MS) / 2, middle = (fromMs + toMs) / 2;
      this.range = [middle - half, middle + half];
      this.plots.forEach((plot) => plot.setScale("x", { min: this.range[0], max: this.range[1] }));
      this.draw();
      this.drive.mark();
    }

    dress() {
      this.plots.forEach((plot) => { plot.setSize({ width: widthOf(this.element), height: plot.height }); plot.redraw(); });
      this.draw();
    }

    // The rows: events, and the bands below them.
    draw() {
      const { rows, drive, range: [fromMs, toMs] } = this;
      this.element.dataset.range = this.range.map(isoOf).join(" ");
      rows.replaceChildren();
      rows.setAttribute("width", widthOf(this.element));
      const clip = svg("clipPath", { id: `${this.element.id}-clip` }, rows);
      svg("rect", { x: LEFT, y: 0, width: this.inner, height: "100%" }, clip);
      svg("rect", { x: LEFT, y: 0, width: this.inner, height: "100%", class: "field" }, rows);
      ["events", ...BANDS].forEach((name, row) => svg("text", { x: LEFT - 6, y: (row + 0.5) * ROW + 4, "text-anchor": "end" }, rows, name));
      const inside = svg("g", { "clip-path": `url(#${this.element.id}-clip)` }, rows);
      drive.figures.bands.forEach((spans, row) => {
        const others = [...new Set(spans.map(([, , value]) => value))].filter((value) => !Object.hasOwn(COLOURS, value));
        for (const [begin, end, value] of spans) {
          if (end < fromMs || begin > toMs) { continue; }
          const [left, right] = [Math.max(this.x(begin), LEFT), Math.min(this.x(end), LEFT + this.inner)];
          const colour = Object.hasOwn(COLOURS, value) ? COLOURS[value] : PALETTE[others.indexOf(value) % PALETTE.length];
          const bar = svg("rect", { class: "bar", x: left, y: (row + 1) * ROW + 4, width: Math.max(right - left, 0.5), height: ROW - 8, fill: colour }, inside);
          svg("title", {}, bar, `${BANDS[row]}: ${value}`);
          if (right - left > 6.5 * value.length + 8) {
            svg("text", { class: "inside", x: (left + right) / 2, y: (row + 1.5) * ROW + 4, "text-anchor": "middle" }, inside, value);
          }
        }
      });
      for (const { ms, kind, text } of drive.figures.moments) {
        if (ms >= fromMs && ms <= toMs) {
          markOf(MARKS[kind], this.x(ms), ROW / 2, text, inside).dataset.ms = ms;
        }
      }
    }

    // The overlays of the charts: outages of the gateway, stops, and the present time.
    mark(cursor, timeMs) {
      const top = cursor.getBoundingClientRect().top;
      const fields = [...this.plots.map((plot) => plot.over), this.rows].map((one) => one.getBoundingClientRect())
        .map((box) => [box.top - top, box.height]);
      const [shades, stops, now] = cursor.children, right = LEFT + this.inner;
      const lines = (times) => times.map((ms) => this.x(ms)).filter((x) => x >= LEFT - 1 && x <= right + 1)
        .flatMap((x) => fields.map(([y, height]) => `M${x.toFixed(1)},${y}v${height}`)).join("");
      now.setAttribute("d", lines([timeMs]));
      stops.setAttribute("d", lines(this.drive.figures.stops));
      shades.setAttribute("d", this.drive.figures.outages.map((span) => span.map((ms) => Math.min(Math.max(this.x(ms), LEFT), right)))
        .flatMap(([from, to]) => fields.map(([y, height]) => `M${from},${y}H${to}v${height}H${from}Z`)).join(""));
    }
  }

  // One drive: its path, charts, events and player.
  class Drive {
    constructor(figures, number) {
      const of = (name) => document.getElementById(name + "-" + number);
      this.figures = figures;
      this.robot = figures.robot;
      [this.fromMs, this.toMs] = [figures.from_ms, figures.to_ms];
      this.player = of("player");
      this.elements = [of("map"), of("time")];
      [this.place, this.cursor] = this.elements.map((element) => element.nextElementSibling); // the overlays of the charts
      this.lines = figures.lines.map(([steps, values]) => [sums(steps), values]);
      this.path = { ...figures.path, time_ms: sums(figures.path.time_ms) };
      this.begins = new Set(this.path.begins);
      // The path has its own order if the clock was set back.
      this.order = Array.from(this.path.time_ms.keys()).sort((one, other) => this.path.time_ms[one] - this.path.time_ms[other]);
      this.times = this.order.map((at) => this.path.time_ms[at]);
      [this.button, this.slider, this.speed, this.clock, this.said] = ["button", "input", "select", "a", ".said"].map(
        (name) => this.player.querySelector(name));
      this.rows = Array.from(of("drive").querySelectorAll("tr[data-ms]"));
      this.rowsMs = this.rows.map((row) => Number(row.dataset.ms));
      this.atMs = null;
      this.hoverMs = null;
      const measured = (number) => lineOf(this.lines[LINES.findIndex((line) => line.chart === number && line.name === "measured")]);
      this.values = CHARTS.map(({ unit, digits }, number) => [measured(number), digits, unit]);
      this.bands = figures.bands.map(bandOf);
      this.listen();
    }

    listen() {
      this.slider.max = String(Math.max(1, Math.round(this.toMs - this.fromMs)));
      this.player.hidden = false;
      this.show(this.fromMs, false);
      this.slider.addEventListener("input", () => { this.pause(); this.show(this.fromMs + Number(this.slider.value)); });
      this.slider.addEventListener("keydown", (event) => this.press(event));
      this.button.addEventListener("click", () => { if (playing === this) { this.pause(); } else { this.play(); } });
    }

    press(event) {
      if (event.altKey || event.ctrlKey || event.metaKey) { return; }
      const ends = { Home: this.fromMs, End: this.toMs };
      if (event.key === " ") { this.button.click(); }
      else if (event.key in ends) { this.pause(); this.show(ends[event.key]); }
      else if (event.key in STEP_MS) { this.pause(); this.show(this.atMs + STEP_MS[event.key] * (event.shiftKey ? 10 : 1)); }
      else { return; }
      event.preventDefault();
    }

    draw() {
      if (this.time) { return; }
      const [map, time] = this.elements;
      this.map = new PathMap(map, this);
      this.time = new TimeCharts(time, this);
      drawn += this.elements.length;
      this.dress();
      new ResizeObserver(() => { if (widthOf(time) !== this.width) { this.dress(); } }).observe(time);
    }

    // In the page's colours and width; the zoom stays.
    dress() {
      if (!this.time) { return; }
      this.width = widthOf(this.elements[1]);
      this.map.draw();
      this.time.dress();
      this.mark();
    }

    hover(timeMs) {
      this.hoverMs = timeMs;
      this.mark();
    }

    // The moment at the pointer; the arrow keys continue from it.
    choose(timeMs) {
      this.pause();
      this.show(timeMs);
      this.slider.focus({ preventScroll: true });
    }

    play() {
      if (playing) { playing.pause(); }
      playing = this;
      this.button.textContent = "Pause";
      if (this.atMs >= this.toMs) { this.show(this.fromMs); }
      let before = performance.now();
      const step = (now) => {
        if (playing !== this) { return; }
        // A hidden page continues where it was.
        this.show(this.atMs + Math.min(now - before, 250) * Number(this.speed.value));
        before = now;
        if (this.atMs >= this.toMs) { this.pause(); } else { requestAnimationFrame(step); }
      };
      requestAnimationFrame(step);
    }

    pause() {
      if (playing !== this) { return; }
      playing = null;
      this.button.textContent = "Play";
    }

    // Shows a moment on path, charts and events.
    show(timeMs, isWritten = true) {
      const atMs = Math.min(Math.max(timeMs, this.fromMs), this.toMs);
      this.atMs = atMs;
      this.slider.value = String(Math.round(atMs - this.fromMs));
      this.clock.textContent = clockOf(atMs);
      this.clock.href = hashOf(this, atMs);
      const values = this.values.map(([of, digits, unit]) => [of(atMs), digits, unit]);
      const said = [...values.map(([value, digits, unit]) => (value === null ? "" : fixed(value, digits) + unit)),
        ...this.bands.map((of) => of(atMs))].filter(Boolean).join(" · ") || "no data";
      this.said.textContent = said;
      this.slider.setAttribute("aria-valuetext", clockOf(atMs) + " UTC, " + said);
      const rowMs = this.rowsMs[newest(this.rowsMs, atMs)];
      if (rowMs !== this.rowMs) {
        this.rows.forEach((row, at) => {
          if (this.rowsMs[at] === rowMs) { row.setAttribute("aria-current", "time"); } else { row.removeAttribute("aria-current"); }
        });
        this.rowMs = rowMs;
      }
      this.mark();
      if (isWritten) { write(this); }
    }

    // The pose: x and y in metres, and the heading in radians.
    pose(timeMs) {
      const { times, order, path: { x_m: xs, y_m: ys, heading_deg: headings } } = this;
      if (!times.length) { return null; }
      const at = Math.max(0, newest(times, timeMs)), [here, there] = [order[at], order[at + 1]];
      const pose = [xs[here], ys[here], headings[here]];
      if (at + 1 < times.length && timeMs > times[at] && !this.begins.has(there)) {
        const fromMs = Math.max(times[at], times[at + 1] - REACH_MS);
        const part = Math.max(0, (timeMs - fromMs) / (times[at + 1] - fromMs));
        const turn = ((headings[there] - headings[here] + 540) % 360) - 180;
        pose[0] += part * (xs[there] - xs[here]);
        pose[1] += part * (ys[there] - ys[here]);
        pose[2] += part * turn;
      }
      pose[2] *= Math.PI / 180;
      return pose;
    }

    // Draws the robot on the path and the time across the charts, also for the pointer.
    mark() {
      if (!this.time) { return; }
      const [robot, ghost] = this.place.children;
      this.time.mark(this.cursor, this.atMs);
      this.outline(robot, this.atMs);
      this.outline(ghost, this.hoverMs);
    }

    outline(element, timeMs) {
      const pose = timeMs === null ? null : this.pose(timeMs);
      if (!pose) { element.setAttribute("d", ""); return; }
      const [x, y, heading] = pose, [left, top] = this.map.place(x, y), { field } = this.map;
      const isSeen = left >= field.x && left <= field.x + field.width && top >= field.y && top <= field.y + field.height;
      const pxPerM = Math.max(this.map.scale, OUTLINE_PX / 1.05);
      const [sin, cos] = [Math.sin(heading), Math.cos(heading)];
      const corners = OUTLINE_M.map(([ahead, aside]) =>
        `${(left + (ahead * cos - aside * sin) * pxPerM).toFixed(1)},${(top - (ahead * sin + aside * cos) * pxPerM).toFixed(1)}`);
      element.setAttribute("d", isSeen ? `M${corners.join("L")}Z` : "");
      element.dataset.pose = [x, y, heading].map((value) => value.toFixed(3)).join(" ");
    }
  }

  let playing = null;
  let written = "", writing = 0;
  const isAlone = new Set(drives.map((drive) => drive.robot)).size < 2;

  function hashOf(drive, timeMs) {
    return "#t=" + isoOf(timeMs) + (isAlone ? "" : "&robot=" + encodeURIComponent(drive.robot));
  }

  function write(drive) {
    written = hashOf(drive, drive.atMs);
    if (!writing) {
      writing = setTimeout(() => { writing = 0; history.replaceState(null, "", written); }, WRITE_MS);
    }
  }

  // A time in ISO 8601, by default in UTC, or since 1970 in seconds (or ms, us, ns); NaN if it is neither.
  function parsed(text) {
    if (/^\d+(\.\d+)?$/.test(text)) {
      let seconds = Number(text);
      while (seconds >= 1e11) { seconds /= 1000; }
      return seconds * 1000;
    }
    const [date, time] = text.replace(/ ?UTC$/, "Z").split(/[T ]/);
    return Date.parse(time ? date + "T" + (/(Z|[+-]\d\d:?\d\d)$/i.test(time) ? time : time + "Z") : date);
  }

  // Shows the moment of the address.
  function follow() {
    clearTimeout(writing);
    writing = 0;
    const asked = {};
    for (const part of location.hash.slice(1).split("&")) {
      const [name, value = ""] = part.split(/=(.*)/s);
      try { asked[name] = decodeURIComponent(value); } catch { asked[name] = value; }
    }
    note.hidden = true;
    if (!("t" in asked)) { return; }
    const timeMs = parsed(asked.t);
    const named = all.filter((drive) => !asked.robot || drive.robot === asked.robot);
    const away = (drive) => Math.max(drive.fromMs - timeMs, timeMs - drive.toMs, 0);
    const drive = named.reduce((best, one) => (best && away(best) <= away(one) ? best : one), null);
    if (Number.isNaN(timeMs) || !drive) {
      tell(drive ? `The address has no valid time: ${asked.t}` : `This report has no drive of ${asked.robot}.`);
      return;
    }
    if (away(drive) >= 1) { tell(`This report does not cover ${isoOf(timeMs)}. The nearest moment is shown.`); }
    drive.pause();
    drive.show(timeMs, false);
    drive.draw();
    uncover(drive);
    drive.player.scrollIntoView({ block: "start" });
  }

  function tell(text) {
    note.textContent = text;
    note.hidden = false;
  }

  // Moves the zoom to a moment outside of it.
  function uncover({ time, atMs }) {
    const [from, to] = time.range, half = (to - from) / 2;
    if (atMs < from || atMs > to) { time.zoom(atMs - half, atMs + half); }
  }

  const all = drives.map((figures, number) => new Drive(figures, number));
  if (all.length > EAGER) {
    const near = new IntersectionObserver((seen) => {
      for (const { target, isIntersecting } of seen) {
        if (isIntersecting) { all[Number(target.dataset.number)].draw(); near.unobserve(target); }
      }
    }, { rootMargin: "1000px" });
    all.forEach((_, number) => near.observe(document.getElementById("drive-" + number)));
  } else {
    all.forEach((drive) => drive.draw());
  }
  window.addEventListener("hashchange", follow);
  dark.addEventListener("change", dressAgain);
  phone.addEventListener("change", dressAgain);
  window.addEventListener("beforeprint", () => { print(true); });
  window.addEventListener("afterprint", () => { print(false); });
  follow();
  document.documentElement.dataset.drawn = String(drawn);
})();
