// The first page: a search, a calendar, and what was found; and the page of a day.

import { ask, placeOf } from "./ask.js";
import { foundTable } from "./found.js";
import { h } from "./elements.js";
import { language, t } from "./words.js";

const EXAMPLES = ["drive last 7d", "stop", "incident", "drive distance_m>100", "log lost>0"];
const MONTHS = 3;
const DAY_S = 86400;

const dayAfter = (day) => new Date(Date.parse(day) + 1000 * DAY_S).toISOString().slice(0, 10);

function searchForm(words) {
  const box = h("input", { type: "search", name: "words", "aria-label": t("find_logs"), value: words, maxlength: 1000, autocomplete: "off", spellcheck: "false" });
  const submit = (event) => {
    event.preventDefault();
    location.hash = box.value.trim() ? placeOf.find(box.value.trim()) : "#/";
  };
  return h("search", {},
    h("form", { class: "tools search", onsubmit: submit }, box, h("button", {}, t("find_it"))),
    h("p", { class: "soft examples" }, t("for_example"), " ", EXAMPLES.map((one) => [h("a", { href: placeOf.find(one) }, one), " "])));
}

/** A part of the page that fills itself; it says so where it cannot. */
function filled(promise, show) {
  const place = h("div", {}, h("p", { class: "soft" }, t("working")));
  promise.then((answer) => place.replaceChildren(show(answer)), (error) => place.replaceChildren(h("p", { class: "fault", role: "alert", lang: "en" }, error.message)));
  return place;
}

const find = (words) => filled(ask(`api/find?words=${encodeURIComponent(words)}`), foundTable);

export class SearchPage {
  constructor(words) {
    this.words = words;
    this.shown = MONTHS;
    this.calendar = h("div", { class: "calendar" });
    this.found = h("section", { "aria-label": t("found") });
    this.element = h("div", {}, h("h1", { class: "heard" }, t("logs")), searchForm(words), words ? null : h("section", { class: "card", "aria-label": t("calendar") }, h("h2", {}, t("calendar")), this.calendar), this.found);
    this.update();
  }

  get title() {
    return this.words;
  }

  /** Ask again: at first, and whenever the catalog has changed. */
  update() {
    this.found.replaceChildren(h("h2", {}, this.words || t("newest_drives")), find(this.words || "drive"));
    if (this.words) return;
    ask("api/days").then((days) => {
      this.days = new Map(days.map((one) => [one.day, one]));
      this.showCalendar();
    }, () => {});
  }

  showCalendar() {
    const months = [...new Set([...this.days.keys()].map((day) => day.slice(0, 7)))].reverse();
    const more = () => {
      this.shown += 4 * MONTHS;
      this.showCalendar();
    };
    this.calendar.replaceChildren(
      ...(months.length ? months.slice(0, this.shown).map((month) => this.month(month)) : [h("p", { class: "soft" }, t("nothing_found"))]),
      ...(months.length > this.shown ? [h("button", { type: "button", onclick: more }, t("earlier"))] : []),
      h("p", { class: "soft legend" }, h("b", {}, "1"), " ", t("drives"), " · ", h("b", { class: "level1" }, "1"), " ", t("stops"), " · ", h("b", { class: "level2" }, "1"), " ", t("incidents"), " · UTC"));
  }

  month(month) {
    const first = new Date(`${month}-01T00:00:00Z`);
    const locale = language() === "zh" ? "zh-CN" : "en-GB";
    const named = (date, options) => new Intl.DateTimeFormat(locale, { timeZone: "UTC", ...options }).format(date);
    // The third of January 2000 was a Monday.
    const weekdays = [...Array(7).keys()].map((at) => named(new Date(Date.UTC(2000, 0, 3 + at)), { weekday: "short" }));
    const days = new Date(Date.UTC(first.getUTCFullYear(), first.getUTCMonth() + 1, 0)).getUTCDate();
    const cells = [...Array((first.getUTCDay() + 6) % 7).fill(""), ...[...Array(days).keys()].map((at) => `${month}-${String(at + 1).padStart(2, "0")}`)];
    const weeks = [...Array(Math.ceil(cells.length / 7)).keys()].map((at) => cells.slice(7 * at, 7 * at + 7));
    return h("table", { class: "month" },
      h("caption", {}, named(first, { month: "long", year: "numeric" })),
      h("thead", {}, h("tr", {}, weekdays.map((name) => h("th", { scope: "col" }, name)))),
      h("tbody", {}, weeks.map((week) => h("tr", {}, week.map((day) => this.day(day))))));
  }

  day(day) {
    const found = this.days.get(day);
    if (!found) return h("td", { class: "soft" }, day && String(Number(day.slice(8))));
    const said = `${day}: ${t("drives")} ${found.drives}, ${t("stops")} ${found.stops}, ${t("incidents")} ${found.incidents}`;
    return h("td", {}, h("a", { href: placeOf.day(day), "aria-label": said, title: said },
      h("span", {}, String(Number(day.slice(8)))), h("b", {}, found.drives || ""),
      found.stops ? h("b", { class: "level1" }, found.stops) : null, found.incidents ? h("b", { class: "level2" }, found.incidents) : null));
  }
}

export class DayPage {
  constructor(day) {
    this.day = day;
    this.element = h("div", {});
    this.update();
  }

  get title() {
    return this.day;
  }

  update() {
    const period = `from ${this.day} to ${dayAfter(this.day)}`;
    const part = (name, words) => h("section", { "aria-label": t(name) }, h("h2", {}, t(name)), find(`${words} ${period}`));
    this.element.replaceChildren(searchForm(`drive ${period}`), h("h1", {}, this.day), part("incidents", "incident"), part("drives", "drive"), part("stops", "stop"));
  }
}
