// One robot in detail: its state, blockers, speeds and angles over time, its path, its chassis, its events.

import { FRESH_MS, SampleClock } from "./contact.js";
import { h, number, setText } from "./elements.js";
import { Path } from "./path.js";
import { languageOf, meaningOf, said, t, textOf, valueOf, whyOf, wordOf } from "./words.js";

const SHOWN_S = 120;
const EVENTS_SHOWN = 50;
const IDLE = ["no_lease", "not_engaged"];
const SPEEDS = ["asked_mps", "told_mps", "speed_mps", "limit_mps"];
const ANGLES = ["asked_deg", "told_deg", "angle_deg"];

/** The speed limit in force, also of a robot that idles. */
const limitOf = (safety) => Math.min(safety.speed_limit_mps, safety.travel_speed_limit_mps ?? Infinity);

/** A wide page has space for a higher chart. */
const chartHeight = (chart) => (chart.clientWidth > 500 ? 205 : 170);

export class RobotPage {
  constructor(name, fleet, driver) {
    this.name = name;
    this.fleet = fleet;
    this.driver = driver; // the panel to drive it
    this.state = this.safety = this.why = null; // the newest of each, decoded; null once it is old
    this.heardMs = performance.now(); // a robot of which nothing comes is lost from now on
    this.safetyMs = this.whyMs = 0;
    this.clock = new SampleClock();
    this.points = [[], ...[...SPEEDS, ...ANGLES].map(() => [])]; // time, and each field
    this.word = h("b", { class: "word" });
    this.what = h("span");
    this.alert = h("span", { class: "heard", role: "alert" }); // for screen readers: once, not ten times a second
    this.band = h("section", { class: "band wide", "aria-label": t("state") }, h("h1", {}, name), this.word, this.what, this.alert, driver.buttons);
    this.speed = h("span", { class: "big" });
    this.angle = h("span", { class: "big" });
    this.limit = h("span");
    this.gauge = h("i");
    this.linkText = h("span");
    this.linkMore = h("span", { class: "more" });
    this.notes = h("ul", { class: "card wide soft notes" });
    this.reasons = h("ul");
    this.blockers = h("section", { class: "card wide why", "aria-label": t("blockers"), hidden: true }, h("h2", {}, t("blockers")), this.reasons);
    this.facts = h("dl", { class: "facts" });
    this.events = h("ul", { class: "events", tabindex: "0", "aria-label": t("events") }, h("li", { class: "soft" }, t("no_events")));
    this.charts = [h("div", { class: "chart" }), h("div", { class: "chart" })];
    this.logs = h("p", { class: "past", hidden: true }, h("a", { href: `#/logs?robot=${name}` }, t("logs_of", name)));
    const canvas = h("canvas", { class: "path", role: "img", "aria-label": t("path") });
    this.path = new Path(canvas);
    this.element = h("div", { class: "robot" }, this.band,
      h("section", { class: "card wide top" },
        h("div", { class: "now" }, this.speed, this.angle, this.limit,
          h("span", { class: "link" }, `${t("link_age")}: `, h("span", { class: "gauge" }, this.gauge), " ", this.linkText, this.linkMore))),
      this.blockers, this.driver.element, this.notes,
      h("section", { class: "card past" }, h("h2", {}, t("speed_chart")), this.charts[0], h("h2", {}, t("angle_chart")), this.charts[1]),
      h("section", { class: "card" }, h("h2", {}, t("path")), canvas, h("h2", {}, t("facts")), this.facts),
      h("section", { class: "card wide past" }, h("h2", {}, t("events")), this.events), this.logs);
    this.update();
  }

  /** The elements are in the page: make what needs their size. */
  begin() {
    const axis = { stroke: () => getComputedStyle(document.body).color, grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8884" } };
    const series = (label, stroke, more = {}) => ({ label, stroke, width: 2, value: (_, value) => number(value), ...more });
    const make = (target, all) => new uPlot({
      width: target.clientWidth, height: chartHeight(target), legend: { live: false }, series: [{ label: "", value: (_, value) => number(value, 1, "s") }, ...all],
      scales: { x: { time: false } }, axes: [{ ...axis, size: 28, values: (_, all) => all.map((s) => `${s} s`) }, axis], cursor: { sync: { key: "robot" } },
    }, [[]], target);
    const asked = series(t("asked"), "#9467bd", { dash: [4, 4] });
    this.plots = [
      make(this.charts[0], [asked, series(t("told"), "#2a78c2"), series(t("measured"), "#1b9e5a"), series(t("limit").toLowerCase(), "#e5484d", { dash: [8, 4], width: 1 })]),
      make(this.charts[1], [asked, series(t("told"), "#2a78c2"), series(t("measured"), "#1b9e5a")]),
    ];
    this.observer = new ResizeObserver(() => this.plots.forEach((plot, at) => plot.setSize({ width: this.charts[at].clientWidth, height: chartHeight(this.charts[at]) })));
    this.observer.observe(this.charts[0]);
    this.timer = setInterval(() => this.update(), 100);
  }

  end() {
    this.driver.end();
    clearInterval(this.timer);
    this.observer?.disconnect();
    this.plots?.forEach((plot) => plot.destroy());
  }

  /** The last minutes, as stored by the desk. */
  receiveHistory(history, hello) {
    const { values, age_s: ageS } = history;
    const length = values.speed_mps.length;
    const now = performance.now() / 1000 - ageS;
    this.points[0] = values.speed_mps.map((_, at) => now - (length - 1 - at) * hello.period_s);
    [...SPEEDS, ...ANGLES].forEach((name, at) => (this.points[at + 1] = values[name]));
    this.logs.hidden = !hello.has_logs;
    this.path.clear();
    for (let at = 0; at < length; at++) this.path.go(values.x_m[at], values.y_m[at], values.heading_rad[at]);
  }

  receivePose(pose) {
    this.path.go(pose.x_m, pose.y_m, pose.heading_rad);
  }

  async receiveSample(sample) {
    const { subject, payload } = sample;
    if (subject === "safety/state") this.driver.receiveState(sample);
    if (!(await this.driver.believes(sample))) return;
    const message = MessagePack.decode(payload);
    if (subject === "safety/event") return this.receiveEvent(message);
    if (subject !== "state" && subject !== "safety/state") return;
    // A sample that waited behind a hanging process is not current.
    const nowMs = performance.now();
    if (this.clock.delayMs(message.time_ns, nowMs) > FRESH_MS) return;
    if (subject === "state") return this.receiveState(message, nowMs);
    this.safety = message;
    this.safetyMs = nowMs;
  }

  receiveState(state, nowMs) {
    this.state = state;
    this.heardMs = nowMs;
    const safety = this.safety;
    const limit = safety && limitOf(safety);
    const point = [nowMs / 1000, safety?.target_speed_mps, safety?.output_speed_mps, state.speed_mps, limit, safety?.target_angle_deg, safety?.output_angle_deg, state.angle_deg];
    this.points.forEach((column, at) => column.push(point[at] ?? null));
    const old = this.points[0].findIndex((time) => time > nowMs / 1000 - 2 * SHOWN_S);
    if (old > 400) this.points.forEach((column) => column.splice(0, old));
  }

  receiveEvent(event) {
    if (this.events.querySelector(".soft")) this.events.replaceChildren();
    const at = new Date(event.time_ns / 1e6).toLocaleTimeString();
    this.events.prepend(h("li", { class: event.severity, lang: languageOf(event.text) }, `${at}  ${said(event.text)}${event.operator && !event.text.includes(event.operator) ? ` (${event.operator})` : ""}`));
    while (this.events.childElementCount > EVENTS_SHOWN) this.events.lastElementChild.remove();
  }

  /** The reasons why it does not move, from the desk. */
  receiveWhy(why) {
    this.why = why;
    this.whyMs = performance.now();
  }

  showWhy() {
    const text = JSON.stringify(this.why && [this.why.reasons, this.why.notes]);
    if (this.whyText === text) return;
    this.whyText = text;
    // A missing driver is no fault: the band shows it.
    const blockers = (this.why?.reasons ?? []).filter(([reason]) => !IDLE.includes(reason));
    this.reasons.replaceChildren(...blockers.map(([reason, means, cure]) => {
      const [ours, how] = whyOf(reason, means, cure, this.name);
      return h("li", {}, h("b", {}, ours), ` (${reason})`, how && h("div", { class: "soft" }, `${t("cure")}: ${how}`));
    }));
    this.blockers.hidden = blockers.length === 0;
    this.notes.replaceChildren(...(this.why?.notes ?? []).map((note) => h("li", { lang: languageOf(note) }, said(note))));
  }

  /** Nothing arrived for a second, by this page's clock: the robot may be moving. */
  get isLost() {
    return performance.now() - this.heardMs >= FRESH_MS;
  }

  /** The most important line: state, driver, reason and time. */
  showBand(row) {
    const known = row !== undefined && (this.isLost ? row.word === "offline" : this.state !== null);
    this.band.className = `band wide level${this.isLost ? 2 : known ? row.level : 1}`;
    setText(this.word, this.isLost ? wordOf("offline") : known ? wordOf(row.word) : "…");
    const parts = this.isLost ? [t("no_contact", this.name, ((performance.now() - this.heardMs) / 1000).toFixed(1))] : [];
    const holder = this.safety?.lease_holder;
    if (holder) parts.push(this.driver.driving ? t("in_control_here") : t("in_control", holder));
    // The row of an offline robot begins with the time, which this page knows better.
    if (known && row.level > 0) parts.push(this.isLost ? said(row.text.split("; ").slice(1).join("; ")) : textOf(row));
    if (this.safety?.stopped_by?.length) parts.push(t("stopped_by", this.safety.stopped_by.join(", ")));
    if (this.why) parts.push(t("since", new Date(Date.now() - 1000 * this.why.since_s).toLocaleTimeString()));
    setText(this.what, parts.filter(Boolean).join(" · "));
    if (!this.isLost) setText(this.alert, "");
    else if (!this.alert.textContent) setText(this.alert, parts[0]);
  }

  update() {
    const nowMs = performance.now();
    if (this.isLost) this.state = this.safety = this.why = null;
    if (nowMs - this.safetyMs >= FRESH_MS) this.safety = null;
    if (nowMs - this.whyMs >= FRESH_MS) this.why = null;
    const row = this.fleet.rows.get(this.name);
    const { state, safety } = this;
    this.element.classList.toggle("lost", this.isLost);
    this.showBand(row);
    this.showWhy();
    setText(this.speed, number(state?.speed_mps, 2, "m/s"));
    setText(this.angle, number(state?.angle_deg, 1, "°"));
    setText(this.limit, `${t("limit")}: ${number(safety && limitOf(safety), 2, "m/s")}`);
    const age = safety?.link_age_s ?? null;
    setText(this.linkText, age === null ? t("obeys_none") : `${Math.round(1000 * age)} ms`);
    const p99 = safety?.link_age_p99_s ?? null;
    setText(this.linkMore, age === null ? "" : t("link_more", p99 === null ? "--" : Math.round(1000 * p99), Math.round(1000 * safety.deadman_s), number(safety.travel_delay_m)));
    const share = age === null ? 0 : Math.min(1, safety.travel_speed_limit_mps / safety.speed_limit_mps);
    this.gauge.style.width = `${100 * share}%`;
    this.updateFacts(state);
    this.driver.update(safety);
    // While the pad may be held, nothing above it changes its size.
    this.element.classList.toggle("driving", this.driver.driving);
    this.path.draw();
    if (this.plots) {
      const now = performance.now() / 1000;
      const time = this.points[0].map((one) => one - now);
      this.plots[0].setData([time, ...this.points.slice(1, 5)], false);
      this.plots[1].setData([time, ...this.points.slice(5)], false);
      for (const [at, plot] of this.plots.entries()) {
        plot.setScale("x", { min: -SHOWN_S, max: 0 });
        const all = this.points.slice(at ? 5 : 1, at ? undefined : 5).flat().filter((value) => value !== null);
        // Keep lines off the edge, where half of them would be cut off.
        plot.setScale("y", { min: 1.1 * Math.min(at ? -5 : -0.2, ...all), max: 1.1 * Math.max(at ? 5 : 0.5, ...all) });
      }
    }
  }

  updateFacts(state) {
    const on = (pairs) => pairs.filter(([, value]) => value).map(([name]) => t(name)).join(", ");
    const rows = state === null ? [] : [
      ["mode", valueOf(state.mode)], ["gear", valueOf(state.gear_position)], ["braking", valueOf(state.braking_status)], ["parking", valueOf(state.parking_status)],
      ["bumpers", state.front_bumper === null ? "--" : on([["front", state.front_bumper], ["rear", state.rear_bumper]]) || t("clear")],
      ["lamps", on([["headlamp", state.headlamp], ["left_lamp", state.left_indicator], ["right_lamp", state.right_indicator], ["horn", state.horn]]) || t("off")],
      ["mileage", number(state.total_mileage_km, 3, "km")], ["silent_frames", state.silent.join(", ") || t("none")],
      ["latched", this.safety?.latched.map((one) => meaningOf(one)).join(", ") || t("none")],
    ];
    const text = JSON.stringify(rows);
    if (text === this.factsText) return;
    this.factsText = text;
    this.facts.replaceChildren(...rows.flatMap(([name, value]) => [h("dt", {}, t(name)), h("dd", {}, value)]));
  }
}
