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

/** A part of the page that fills itself. What is shown already stays as it is: somebody may be about to press it. */
class Filled {
  constructor(path, show) {
    this.path = path;
    this.show = show;
    this.asked = 0;
    this.element = h("div", {}, h("p", { class: "soft" }, t("working")));
    this.update();
  }

  async update() {
    const asked = ++this.asked;
    const shown = await ask(this.path).then((answer) => [JSON.stringify(answer), () => this.show(answer)],
      (error) => [error.message, () => h("p", { class: "fault", role: "alert", lang: "en" }, error.message)]);
    // An answer that was overtaken is of an older catalog.
    if (asked !== this.asked || shown[0] === this.shown) return;
    this.shown = shown[0];
    this.element.replaceChildren(shown[1]());
  }
}

const find = (words) => new Filled(`api/find?words=${encodeURIComponent(words)}`, foundTable);

export class SearchPage {
  constructor(words) {
    this.words = words;
    this.months = MONTHS;
    this.calendar = h("div", { class: "calendar" });
    const days = words ? null : new Filled("api/days", (answer) => this.calendarOf(answer));
    const found = find(words || "drive");
    this.parts = [days, found].filter(Boolean);
    this.element = h("div", {}, h("h1", { class: "heard" }, t("logs")), searchForm(words),
      days && h("section", { class: "card", "aria-label": t("calendar") }, h("h2", {}, t("calendar")), days.element),
      h("section", { "aria-label": t("found") }, h("h2", {}, words || t("newest_drives")), found.element));
  }

  get title() {
    return this.words;
  }

  /** Ask again, because the catalog has changed. */
  update() {
    for (const one of this.parts) one.update();
  }

  calendarOf(days) {
    this.days = new Map(days.map((one) => [one.day, one]));
    this.showCalendar();
    return this.calendar;
  }

  showCalendar() {
    const months = [...new Set([...this.days.keys()].map((day) => day.slice(0, 7)))].reverse();
    const more = () => {
      this.months += 4 * MONTHS;
      this.showCalendar();
    };
    this.calendar.replaceChildren(
      ...(months.length ? months.slice(0, this.months).map((month) => this.month(month)) : [h("p", { class: "soft" }, t("nothing_found"))]),
      ...(months.length > this.months ? [h("button", { type: "button", onclick: more }, t("earlier"))] : []),
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
    const period = `from ${day} to ${dayAfter(day)}`;
    const named = [["incidents", "incident"], ["drives", "drive"], ["stops", "stop"]].map(([name, words]) => [name, find(`${words} ${period}`)]);
    this.parts = named.map(([, part]) => part);
    this.element = h("div", {}, searchForm(`drive ${period}`), h("h1", {}, day),
      named.map(([name, part]) => h("section", { "aria-label": t(name) }, h("h2", {}, t(name)), part.element)));
  }

  get title() {
    return this.day;
  }

  update() {
    for (const one of this.parts) one.update();
  }
}
