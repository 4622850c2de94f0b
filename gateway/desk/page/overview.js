// All robots: a table, or tiles for a screen on the wall. What needs a person comes first.

import { operatorName } from "./drive.js";
import { h, number, setText } from "./elements.js";
import { countOf, said, t, textOf, valueOf, WORDS, wordOf } from "./words.js";

const natural = new Intl.Collator(undefined, { numeric: true }).compare;

export class Overview {
  constructor(fleet, link, wall) {
    this.fleet = fleet;
    this.link = link;
    this.wall = wall;
    this.order = { column: "state", down: true }; // what needs a person comes first
    this.shown = new Map(); // robot -> {element, parts, row}
    this.search = h("input", { type: "search", placeholder: t("search"), "aria-label": t("search"), oninput: () => this.update() });
    const option = (value) => h("option", { value }, t(value));
    this.filter = h("select", { "aria-label": t("state"), onchange: () => this.update() }, option("all"), option("needs_person"));
    this.count = h("span", { class: "soft", role: "status" });
    this.body = wall ? h("div", { class: "wall" }) : h("tbody");
    this.empty = h("p", { class: "soft" }, t("no_robot"));
    this.full = h("p", { class: "pill level2", role: "alert", hidden: true }, t("too_many"));
    this.recorders = h("p", { class: "soft" });
    this.contact = h("p", { class: "band level2", role: "status", hidden: true });
    this.element = h("div", {}, h("h1", { class: "heard" }, t("fleet")), this.contact,
      h("div", { class: "tools" }, wall ? null : [this.search, this.filter], this.count),
      wall ? this.body : h("table", { class: "fleet" }, this.head(), this.body),
      this.empty, this.full, this.recorders);
    this.update();
  }

  /** Show the current rows; of each robot only the changes. */
  update() {
    const wanted = this.search.value.trim().toLowerCase();
    const rowOf = (name) => this.fleet.rows.get(name);
    const names = [...this.fleet.rows.keys()].filter((name) => this.isShown(name, rowOf(name), wanted));
    const key = new Map(names.map((name) => [name, SORTED[this.order.column](rowOf(name), name)]));
    const sign = this.order.down ? -1 : 1;
    names.sort((one, other) => sign * compare(key.get(one), key.get(other)) || natural(one, other));
    for (const [name, shown] of this.shown) {
      if (names.includes(name)) continue;
      shown.element.remove();
      this.shown.delete(name);
    }
    let before = null;
    for (const name of names) {
      const row = this.fleet.rows.get(name);
      let shown = this.shown.get(name);
      if (shown === undefined) this.shown.set(name, (shown = this.wall ? tile(name) : this.line(name)));
      if (shown.row !== row) fill(shown, row);
      // An element in its place is not moved: moving it loses the focus.
      const next = before === null ? this.body.firstChild : before.nextSibling;
      if (next !== shown.element) this.body.insertBefore(shown.element, next);
      before = shown.element;
    }
    const rows = [...this.fleet.rows.values()];
    const unseen = rows.filter((row) => row.level === 2 && !row.acknowledged).length;
    const counted = [...WORDS].reverse().map((word) => [rows.filter((row) => row.word === word).length, word]).filter(([count]) => count);
    setText(this.count, [...counted.map(([count, word]) => countOf(count, word)), unseen && `${unseen} ${t("unseen")}`].filter(Boolean).join(", "));
    this.empty.hidden = rows.length > 0;
    this.full.hidden = !this.fleet.full;
    const gib = (bytes) => (bytes === null ? "--" : `${(bytes / 2 ** 30).toFixed(1)} GiB`);
    setText(this.recorders, this.fleet.recorders.length === 0 ? "" : `${t("recorders")}: ${this.fleet.recorders
      .map((one) => `${one.name} ${valueOf(one.state)}, ${robots(one.robots)}, ${one.lost} ${t("lost_samples")}, ${gib(one.disk_free_bytes)} ${t("free")}`).join("; ")}`);
  }

  /** Show why nothing here is current, if so. */
  showContact(text) {
    this.contact.hidden = text === "";
    setText(this.contact, text);
  }

  isShown(name, row, wanted) {
    if (this.filter.value === "needs_person" && row.level === 0) return false;
    return wanted === "" || [name, row.driver, row.text, textOf(row), wordOf(row.word)].some((text) => text.toLowerCase().includes(wanted));
  }

  /** The table's head: a press sorts by that column, a second one in reverse. */
  head() {
    this.heads = new Map(COLUMNS.map(([name, kind]) => {
      const sort = () => {
        const { column, down } = this.order;
        this.order = { column: name, down: name === column ? !down : name === "state" };
        this.showOrder();
        this.update();
      };
      return [name, h("th", { scope: "col", class: kind }, h("button", { type: "button", class: "plain", onclick: sort }, t(name)))];
    }));
    this.showOrder();
    return h("thead", {}, h("tr", {}, ...this.heads.values()));
  }

  showOrder() {
    for (const [name, element] of this.heads) {
      if (name === this.order.column) element.setAttribute("aria-sort", this.order.down ? "descending" : "ascending");
      else element.removeAttribute("aria-sort");
    }
  }

  line(name) {
    const parts = Object.fromEntries(COLUMNS.map(([column, kind]) => [column, h("td", { class: kind })]));
    const pill = h("span", { class: "pill" });
    const text = h("span");
    const seen = h("span", { class: "soft" });
    const acknowledge = () => {
      const { isOwn, word } = this.fleet.rows.get(name);
      if (!isOwn) return this.link.send({ is: "acknowledge", robot: name, word, operator: operatorName() });
      // Known only here, from before the page lost the desk.
      this.fleet.rows.delete(name);
      return this.update();
    };
    const see = h("button", { type: "button", class: "small", onclick: acknowledge, "aria-label": `${t("acknowledge")} ${name}` }, t("acknowledge"));
    parts.robot.append(h("a", { href: `#/robot/${name}` }, name));
    parts.state.append(pill);
    parts.what.append(text, " ", seen, see);
    return { element: h("tr", { "data-robot": name }, ...Object.values(parts)), parts: { ...parts, pill, what: text, seen, see }, row: null };
  }
}

const COLUMNS = [["robot"], ["state"], ["driver", "hide"], ["speed", "number"], ["limit", "number hide"], ["link_age", "number hide"], ["lost", "number hide"], ["what", "what"]];

/** The value that a column sorts by. Acknowledged alarms come after the others. */
const SORTED = {
  robot: (row, name) => name,
  state: (row) => 2 * WORDS.length * (2 * row.level - (row.acknowledged ? 1 : 0)) - WORDS.indexOf(row.word),
  driver: (row) => row.driver,
  speed: (row) => (row.speed_mps === null ? -1 : Math.abs(row.speed_mps)),
  limit: (row) => row.limit_mps ?? -1,
  link_age: (row) => row.link_age_s ?? -1,
  lost: (row) => row.lost ?? -1,
  what: (row) => row.text,
};

const robots = (count) => `${count} ${t(count === 1 ? "one_robot" : "robots")}`;

const compare = (one, other) => (typeof one === "string" ? natural(one, other) : one - other);

function tile(name) {
  const parts = { pill: h("span"), speed: h("span"), driver: h("span") };
  const element = h("a", { class: "tile", href: `#/robot/${name}`, "data-robot": name }, h("b", {}, name), parts.pill, h("br"), parts.speed, " ", parts.driver);
  return { element, parts, row: null };
}

function fill(shown, row) {
  const { parts, element } = shown;
  shown.row = row;
  setText(parts.pill, wordOf(row.word));
  setText(parts.driver, row.driver);
  setText(parts.speed, number(row.speed_mps, 2, "m/s"));
  if (parts.what === undefined) {
    element.className = `tile level${row.level}`;
    return;
  }
  element.className = `row${row.level}`;
  parts.pill.className = `pill level${row.level}`;
  setText(parts.limit, number(row.limit_mps, 2, "m/s"));
  setText(parts.link_age, row.link_age_s === null ? "--" : `${Math.round(1000 * row.link_age_s)} ms`);
  setText(parts.lost, row.lost === null ? "--" : String(row.lost));
  // If nothing is wrong, word and driver are enough.
  setText(parts.what, row.level > 0 ? textOf(row) : row.event && `${t("last_event")}: ${said(row.event)}`);
  setText(parts.seen, row.acknowledged ? `${t("seen_by")} ${row.acknowledged}` : "");
  parts.see.hidden = row.level < 2 || row.acknowledged !== "";
}
