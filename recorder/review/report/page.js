"use strict";
// Draws the charts in the colours of the page, plays the drives on them, and shows the moment of the address:
// report.html#t=2026-01-02T03:04:05.678Z, with &robot=NAME where there are several.
(function () {
  const drives = JSON.parse(document.getElementById("charts").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const phone = window.matchMedia("(max-width: 40rem)");
  const note = document.getElementById("note");
  const drawn = [];
  const EAGER = 4; // more drives than these are drawn when they come near
  const REACH_MS = 2000; // a robot that stood between two places left the first one so long before it came to the other
  const SILENT_MS = 500; // a value that is older is not shown
  const WRITE_MS = 500; // browsers refuse an address that changes too often
  const OUTLINE_M = [[0.75, 0.3], [0.9, 0], [0.75, -0.3], [-0.15, -0.3], [-0.15, 0.3]]; // from the rear axle; as the desk has it
  const OUTLINE_PX = 26; // where it would be smaller it is not to scale
  const STEP_MS = { ArrowLeft: -1000, ArrowDown: -1000, ArrowRight: 1000, ArrowUp: 1000, PageUp: 10000, PageDown: -10000 };

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
    if (begins) { all.forEach((drive) => drive.draw()); }
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

  // What would be shown as minus nothing is nothing.
  const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=[0.]+$)/, "");
  const isoOf = (timeMs) => new Date(Math.round(timeMs)).toISOString();
  const clockOf = (timeMs) => isoOf(timeMs).slice(11, 23);
  const msOf = (date) => (typeof date === "number" ? date : Date.parse(String(date).replace(" ", "T") + "Z"));

  // The number of the newest that is not after the time; -1 if all are.
  function newest(times, timeMs) {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] <= timeMs) { low = middle + 1; } else { high = middle; }
    }
    return low - 1;
  }

  // A player begins with the first message, which may be of another kind than the first sample.
  const reached = (firstMs, timeMs) => (firstMs - timeMs <= SILENT_MS ? Math.max(firstMs, timeMs) : timeMs);

  // A line by its samples, and by where it breaks off.
  function lineOf(trace) {
    const times = [], values = [], isLast = [];
    ((trace && trace.x) || []).forEach((x, at) => {
      if (x === null) { isLast[times.length - 1] = true; } else { times.push(x); values.push(trace.y[at]); isLast.push(false); }
    });
    return (askedMs) => {
      const timeMs = reached(times[0], askedMs);
      const at = newest(times, timeMs);
      return at < 0 || ((isLast[at] || at === times.length - 1) && timeMs - times[at] > SILENT_MS) ? null : values[at];
    };
  }

  function bandOf(traces, row) {
    const bars = traces.filter((trace) => trace.type === "bar" && trace.y[0] === row);
    const firstMs = bars.reduce((first, bar) => Math.min(first, ...bar.base), Infinity);
    return (askedMs) => {
      const timeMs = reached(firstMs, askedMs);
      const bar = bars.find((one) => one.base.some((from, at) => from <= timeMs && timeMs <= from + one.x[at]));
      return bar ? bar.text[0] : "";
    };
  }

  function plain(markup) { return new DOMParser().parseFromString(markup, "text/html").body.textContent; }

  // One drive: its path, its charts over time, its events, and what plays it.
  class Drive {
    constructor(figures, number) {
      const of = (name) => document.getElementById(name + "-" + number);
      this.figures = figures;
      this.robot = figures.robot;
      [this.fromMs, this.toMs] = [figures.from_ms, figures.to_ms];
      this.map = of("map");
      this.time = of("time");
      this.player = of("player");
      this.place = this.map.nextElementSibling; // the pictures over the charts
      this.cursor = this.time.nextElementSibling;
      [this.button, this.slider, this.speed, this.clock, this.said] = ["button", "input", "select", "a", ".said"].map(
        (name) => this.player.querySelector(name));
      this.rows = Array.from(of("drive").querySelectorAll("tr[data-ms]"));
      this.rowsMs = this.rows.map((row) => Number(row.dataset.ms));
      this.atMs = null;
      this.hoverMs = null;
      const traces = figures.time.data;
      const measured = (axis) => lineOf(traces.find((trace) => trace.name === "measured" && trace.yaxis === axis));
      this.values = [[measured("y"), 2, " m/s"], [measured("y2"), 1, "°"]];
      this.bands = ["mode", "arbiter", "lease"].map((row) => bandOf(traces, row));
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
      if (!this.ready) {
        this.ready = Promise.all([draw(this.map, this.figures.map), draw(this.time, this.figures.time)]).then(() => this.link());
      }
      return this.ready;
    }

    link() {
      const { map, time, figures } = this;
      for (const chart of [map, time]) {
        for (const name of ["plotly_afterplot", "plotly_relayouting"]) { chart.on(name, () => this.mark()); }
      }
      time.on("plotly_hover", (event) => {
        this.hoverMs = msOf(event.xvals && event.xvals.length ? event.xvals[0] : event.points[0].x);
        this.mark();
      });
      time.on("plotly_unhover", () => { this.hoverMs = null; this.mark(); });
      time.on("plotly_click", (event) => {
        const mark = event.points.find((point) => point.data.mode === "markers");
        this.choose(mark ? msOf(mark.x) : this.hoverMs ?? msOf(event.points[0].x));
      });
      map.on("plotly_click", (event) => {
        const { x, y } = event.points[0];
        const { x_m: xs, y_m: ys, time_ms: times } = figures.places;
        const away = times.map((_, at) => Math.hypot(xs[at] - x, ys[at] - y));
        this.choose(times[away.indexOf(Math.min(...away))]);
      });
      this.mark();
    }

    // A moment that somebody points at; the arrow keys go on from there.
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
        // A page that was hidden goes on where it was.
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

    // Goes to a moment, on path, charts and events.
    show(timeMs, isWritten = true) {
      const atMs = Math.min(Math.max(timeMs, this.fromMs), this.toMs);
      this.atMs = atMs;
      this.slider.value = String(Math.round(atMs - this.fromMs));
      this.clock.textContent = clockOf(atMs);
      this.clock.href = hashOf(this, atMs);
      const values = this.values.map(([of, digits, unit]) => [of(atMs), digits, unit]);
      const said = [...values.map(([value, digits, unit]) => (value === null ? "" : fixed(value, digits) + unit)),
        ...this.bands.map((of) => plain(of(atMs)))].filter(Boolean).join(" · ") || "no data";
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

    // Where the robot was: x and y in metres, and its heading in radians.
    pose(timeMs) {
      const { time_ms: times, x_m: xs, y_m: ys, heading_deg: headings, begins } = this.figures.places;
      if (!times.length) { return null; }
      const at = Math.max(0, newest(times, timeMs));
      const pose = [xs[at], ys[at], headings[at]];
      if (at + 1 < times.length && timeMs > times[at] && !begins.includes(at + 1)) {
        const fromMs = Math.max(times[at], times[at + 1] - REACH_MS);
        const part = Math.max(0, (timeMs - fromMs) / (times[at + 1] - fromMs));
        const turn = ((headings[at + 1] - headings[at] + 540) % 360) - 180;
        pose[0] += part * (xs[at + 1] - xs[at]);
        pose[1] += part * (ys[at + 1] - ys[at]);
        pose[2] += part * turn;
      }
      pose[2] *= Math.PI / 180;
      return pose;
    }

    // Draws the robot on the path, and the time across the charts; for the pointer, too.
    mark() {
      const [robot, ghost] = this.place.children, [line, field] = [this.cursor.firstElementChild, this.time._fullLayout];
      if (!field || !field._size || !this.map._fullLayout) { return; }
      const { l, t, w, h } = field._size;
      const x = field.xaxis._offset + field.xaxis.l2p(this.atMs);
      line.setAttribute("d", x >= l - 1 && x <= l + w + 1 ? `M${x.toFixed(1)},${t}v${h}` : "");
      this.outline(robot, this.atMs);
      this.outline(ghost, this.hoverMs);
    }

    outline(element, timeMs) {
      const pose = timeMs === null ? null : this.pose(timeMs);
      const { xaxis, yaxis, _size: size } = this.map._fullLayout;
      if (!pose) { element.setAttribute("d", ""); return; }
      const [x, y, heading] = pose;
      const left = xaxis._offset + xaxis.l2p(x), top = yaxis._offset + yaxis.l2p(y);
      const isSeen = left >= size.l && left <= size.l + size.w && top >= size.t && top <= size.t + size.h;
      const pxPerM = Math.max(Math.abs(xaxis.l2p(1) - xaxis.l2p(0)), OUTLINE_PX / 1.05);
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

  // A time in ISO 8601, in UTC unless it names a zone, or since 1970 in seconds (or ms, us, ns); NaN if it is neither.
  function parsed(text) {
    if (/^\d+(\.\d+)?$/.test(text)) {
      let seconds = Number(text);
      while (seconds >= 1e11) { seconds /= 1000; }
      return seconds * 1000;
    }
    const [date, time] = text.replace(/ ?UTC$/, "Z").split(/[T ]/);
    return Date.parse(time ? date + "T" + (/(Z|[+-]\d\d:?\d\d)$/i.test(time) ? time : time + "Z") : date);
  }

  // Goes where the address says.
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
      tell(drive ? `The address names no time: ${asked.t}` : `This report draws no drive of ${asked.robot}.`);
      return;
    }
    if (away(drive) >= 1) { tell(`This report draws nothing of ${isoOf(timeMs)}. The nearest moment is shown.`); }
    drive.pause();
    drive.show(timeMs, false);
    drive.draw().then(() => {
      uncover(drive);
      drive.player.scrollIntoView({ block: "start" });
    });
  }

  function tell(text) {
    note.textContent = text;
    note.hidden = false;
  }

  // A moment outside of what was zoomed in on comes into sight.
  function uncover(drive) {
    const { xaxis } = drive.time._fullLayout;
    const [from, to] = xaxis.range.map((one) => xaxis.r2l(one));
    if (drive.atMs < from || drive.atMs > to) {
      const half = (to - from) / 2;
      Plotly.relayout(drive.time, { "xaxis.range": [isoOf(drive.atMs - half), isoOf(drive.atMs + half)] });
    }
    drive.mark();
  }

  // The library that draws is packed, which makes the page less than half as large. The policy lets in no other script.
  async function unpack() {
    const text = atob(document.getElementById("plotly").textContent);
    const bytes = new Uint8Array(text.length);
    for (let at = 0; at < text.length; at += 1) { bytes[at] = text.charCodeAt(at); }
    const library = document.createElement("script");
    const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    library.textContent = await new Response(unpacked).text();
    document.head.append(library);
  }

  async function begin() {
    await unpack();
    if (all.length > EAGER) {
      const near = new IntersectionObserver((seen) => {
        for (const { target, isIntersecting } of seen) {
          if (isIntersecting) { all[Number(target.dataset.number)].draw(); near.unobserve(target); }
        }
      }, { rootMargin: "1000px" });
      all.forEach((_, number) => near.observe(document.getElementById("drive-" + number)));
    } else {
      await Promise.all(all.map((drive) => drive.draw()));
    }
    window.addEventListener("hashchange", follow);
    dark.addEventListener("change", dressAgain);
    phone.addEventListener("change", dressAgain);
    window.addEventListener("beforeprint", () => { print(true); });
    window.addEventListener("afterprint", () => { print(false); });
    follow();
    document.documentElement.dataset.drawn = String(drawn.length);
  }

  const all = drives.map((figures, number) => new Drive(figures, number));
  if ("DecompressionStream" in window) {
    begin();
  } else {
    tell("The charts need a browser of 2023 or later; all else is here without.");
  }
})();
