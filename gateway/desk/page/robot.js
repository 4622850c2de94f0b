// One robot closely: why it does not move, speeds and angles over time, its path, its chassis, its events.

import { h, number, setText } from "./elements.js";
import { Path } from "./path.js";
import { languageOf, meaningOf, said, t, textOf, valueOf, whyOf, wordOf } from "./words.js";

const FRESH_MS = 1000; // as for `cruiser watch`: older than that nothing is shown as current
const SHOWN_S = 120;
const EVENTS_SHOWN = 50;
const IDLE = ["no_lease", "not_engaged"];
const SPEEDS = ["asked_mps", "told_mps", "speed_mps", "limit_mps"];
const ANGLES = ["asked_deg", "told_deg", "angle_deg"];

/** Beside the path there is room for a higher one. */
const chartHeight = (chart) => (chart.clientWidth > 500 ? 205 : 170);

export class RobotPage {
  constructor(name, fleet, driver) {
    this.name = name;
    this.fleet = fleet;
    this.driver = driver; // the panel to drive it
    this.state = this.safety = this.health = null; // the newest of each, decoded
    this.stateMs = -Infinity;
    this.resets = []; // the buttons beside latched reasons
    this.points = [[], ...[...SPEEDS, ...ANGLES].map(() => [])]; // time, and each field
    this.pill = h("span", { class: "pill" });
    this.speed = h("span", { class: "big" });
    this.angle = h("span", { class: "big" });
    this.holder = h("span");
    this.gauge = h("i");
    this.linkText = h("span");
    this.text = h("p", { class: "soft" });
    this.reasons = h("div");
    this.why = h("section", { class: "card wide why", "aria-label": t("why") }, h("h2", {}, t("why")), this.reasons);
    this.facts = h("dl", { class: "facts" });
    this.events = h("ul", { class: "events", tabindex: "0", "aria-label": t("events") }, h("li", { class: "soft" }, t("no_events")));
    this.charts = [h("div", { class: "chart" }), h("div", { class: "chart" })];
    this.logs = h("ul", { class: "events" });
    this.logCard = h("section", { class: "card wide", "aria-label": t("logs"), hidden: true }, h("h2", {}, t("logs")), this.logs);
    const canvas = h("canvas", { class: "path", role: "img", "aria-label": t("path") });
    this.path = new Path(canvas);
    this.element = h("div", { class: "robot" },
      h("section", { class: "card wide top" },
        h("div", { class: "now" }, h("h1", {}, name), this.pill, this.speed, this.angle,
          h("span", {}, `${t("driver")}: `, this.holder),
          h("span", { class: "link" }, `${t("link_age")}: `, h("span", { class: "gauge" }, this.gauge), " ", this.linkText)),
        this.text),
      this.why, this.driver.element,
      h("section", { class: "card" }, h("h2", {}, t("speed_chart")), this.charts[0], h("h2", {}, t("angle_chart")), this.charts[1]),
      h("section", { class: "card" }, h("h2", {}, t("path")), canvas, h("h2", {}, t("facts")), this.facts),
      h("section", { class: "card wide" }, h("h2", {}, t("events")), this.events), this.logCard);
    this.update();
  }

  /** The newest logs of this robot, each with its report. */
  async showLogs() {
    this.logCard.hidden = false;
    const names = await fetch(`logs/of/${this.name}`).then((answer) => answer.json()).catch(() => []);
    const link = (address, text) => h("a", { href: address, target: "_blank", rel: "noopener" }, text);
    const line = (name) => h("li", {}, link(`reports/${name}`, `${t("report_of")} ${name}`), " ", name.endsWith(".part") ? h("span", { class: "soft" }, t("being_written")) : link(`logs/${name}`, t("download")));
    this.logs.replaceChildren(...(names.length ? names.map(line) : [h("li", { class: "soft" }, t("no_logs"))]));
  }

  /** The elements are in the page: what needs their size is made. */
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

  /** The last minutes, which the desk has kept. */
  receiveHistory(history, hello) {
    const { values, age_s: ageS } = history;
    const length = values.speed_mps.length;
    const now = performance.now() / 1000 - ageS;
    this.points[0] = values.speed_mps.map((_, at) => now - (length - 1 - at) * hello.period_s);
    [...SPEEDS, ...ANGLES].forEach((name, at) => (this.points[at + 1] = values[name]));
    this.wheelbase = hello.wheelbase_m;
    if (hello.has_logs) this.showLogs();
    this.path.clear();
    for (let at = 0; at < length; at++) this.path.go(values.speed_mps[at], values.angle_deg[at], hello.period_s, this.wheelbase);
  }

  async receiveSample(sample) {
    const { subject, payload } = sample;
    if (subject === "safety/state") this.driver.receiveState(sample);
    if (!(await this.driver.believes(sample))) return;
    const message = MessagePack.decode(payload);
    if (subject === "safety/state") this.safety = message;
    else if (subject === "gateway/health") this.health = message;
    else if (subject === "safety/event") this.receiveEvent(message);
    else if (subject === "state") this.receiveState(message);
  }

  receiveState(state) {
    const nowMs = performance.now();
    const sinceS = Math.min((nowMs - this.stateMs) / 1000, FRESH_MS / 1000);
    this.state = state;
    this.stateMs = nowMs;
    if (this.wheelbase) this.path.go(state.speed_mps, state.angle_deg, sinceS, this.wheelbase);
    const safety = this.safety;
    const limit = safety && Math.min(safety.speed_limit_mps, safety.travel_speed_limit_mps ?? Infinity);
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

  /** Why it does not move, as the desk puts it in words. */
  receiveWhy(why) {
    const text = JSON.stringify([why, this.safety?.latched]);
    if (this.whyText === text) return;
    this.whyText = text;
    // That nobody drives it is no fault: the panel below says how to.
    const told = why.reasons.filter(([reason]) => !IDLE.includes(reason));
    this.resets = [];
    const reset = () => {
      const button = h("button", { type: "button", class: "small", disabled: true, onclick: () => this.driver.attempt(() => this.driver.clear()) }, t("reset"));
      this.resets.push(button);
      return button;
    };
    const cures = (reason) => this.safety?.latched.includes(reason) && this.driver.may("reset") && [" ", reset()];
    const items = told.map(([reason, means, cure]) => {
      const [ours, how] = whyOf(reason, means, cure, this.name);
      return h("li", {}, h("b", {}, ours), ` (${reason})`, cures(reason), how && h("div", { class: "soft" }, `${t("cure")}: ${how}`));
    });
    const notes = why.notes.map((note) => h("li", { class: "soft", lang: languageOf(note) }, said(note)));
    const verdict = why.reasons.length === 0 ? t("does_as_told") : why.idle ? t("nothing_wrong") : "";
    this.reasons.replaceChildren(verdict && h("p", {}, verdict), items.length ? h("ul", {}, items) : "", notes.length ? h("ul", {}, notes) : "");
  }

  get isFresh() {
    return performance.now() - this.stateMs < FRESH_MS;
  }

  update() {
    const row = this.fleet.rows.get(this.name);
    const level = this.isFresh ? (row?.level ?? 0) : 2;
    this.pill.className = `pill level${level}`;
    setText(this.pill, this.isFresh && row ? wordOf(row.word) : wordOf("silent"));
    this.why.className = `card wide why level${level}`;
    const { state, safety } = this;
    const fresh = this.isFresh ? state : null;
    setText(this.speed, number(fresh?.speed_mps, 2, "m/s"));
    setText(this.angle, number(fresh?.angle_deg, 1, "°"));
    setText(this.holder, safety?.lease_holder || t("nobody"));
    setText(this.text, this.isFresh ? (row ? textOf(row) : "") : t("silent_now"));
    const age = this.isFresh ? safety?.link_age_s : null;
    setText(this.linkText, age === null || age === undefined ? t("obeys_none") : `${Math.round(1000 * age)} ms, ≤ ${number(safety.travel_speed_limit_mps, 2, "m/s")}`);
    const share = age === null || age === undefined ? 0 : Math.min(1, safety.travel_speed_limit_mps / safety.speed_limit_mps);
    this.gauge.style.width = `${100 * share}%`;
    this.updateFacts(fresh);
    this.driver.update(this.isFresh ? safety : null);
    this.driver.showAskers(row?.asked_by ?? []);
    for (const button of this.resets) button.disabled = this.driver.reset.disabled;
    // Nothing whose size changes stands above the pad while it may be held.
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
        // No line lies on the edge, where half of it would be cut off.
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
