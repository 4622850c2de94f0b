// The logs: search results, incidents first, each with its report, its reason and viewers.

import { h } from "./elements.js";
import { languageOf, meaningOf, said, t, valueOf } from "./words.js";

const SEARCHES = ["incidents", "stops", "events", "drives", "logs"];
const FLAGS = ["robot", "reason", "operator", "since", "until"];
const LEVELS = { error: 2, warning: 1 };
const NEW_PAGE = { target: "_blank", rel: "noopener" };

const part = encodeURIComponent;
const nameOf = (file) => file.split("/").pop();
const told = (text) => h("span", { lang: languageOf(text) }, said(text));
const reportOf = (name, moment = "") => `reports/${part(name)}${moment && `#${moment}`}`;

/** Fetch an answer as text. Throws an Error with a line for people. */
async function ask(path) {
  const answer = await fetch(path).catch(() => {
    throw new Error(t("no_server"));
  });
  const text = await answer.text();
  if (!answer.ok) throw new Error(text.slice(0, 500));
  return text;
}

/** Header and results of an answer, newest first, without an incomplete last line. */
async function find(search, flags) {
  const lines = (await ask(`find?${new URLSearchParams({ search, ...flags })}`)).split("\n").filter(Boolean);
  const [head, ...found] = lines.flatMap((line) => {
    try {
      return [JSON.parse(line)];
    } catch {
      return [];
    }
  });
  return [head, found.reverse()];
}

/** The link that opens a log in a viewer at a moment. */
function viewerOf(viewer, name, time) {
  const url = new URL(viewer.url);
  url.searchParams.set("ds", "remote-file");
  url.searchParams.set("ds.url", new URL(`logs/${part(name)}`, location.href.split("#")[0]).href);
  if (time) url.searchParams.set("time", time);
  return url.href;
}

export class LogsPage {
  constructor(hash) {
    const asked = new URLSearchParams(hash.split("?")[1] ?? "");
    const search = SEARCHES.includes(asked.get("search")) ? asked.get("search") : "";
    this.flags = Object.fromEntries(FLAGS.map((name) => [name, asked.get(name) ?? ""]).filter(([, value]) => value));
    this.reasons = h("datalist", { id: "reasons" });
    this.names = h("ul");
    this.uncataloged = h("section", { class: "card", "aria-label": t("uncataloged"), hidden: true }, h("h2", {}, t("uncataloged")), this.names);
    this.fault = h("div");
    const sections = (search ? [search] : ["incidents", "logs"]).map((one) => {
      const found = h("div", {}, h("p", { class: "soft", role: "status" }, t("reading_logs")));
      return [one, found, h("section", { "aria-label": t(one) }, h("h2", {}, t(one)), found)];
    });
    this.element = h("div", { class: "logs" }, h("h1", { class: "heard" }, t("logs")), this.form(search), this.fault, this.uncataloged, sections.map(([, , element]) => element));
    this.fill(sections);
  }

  /** The flags of "cruiser review find". The page's address contains the search, and can be shared. */
  form(search) {
    const option = (value) => h("option", { value, selected: value === search }, t(value || "incidents_and_logs"));
    const field = (name, more = {}) => h("label", {}, t(`find_${name}`), h("input", { name, value: this.flags[name] ?? "", maxlength: 300, autocomplete: "off", spellcheck: "false", ...more }));
    const submit = (event) => {
      event.preventDefault();
      const asked = new URLSearchParams([...new FormData(event.target)].map(([name, value]) => [name, value.trim()]).filter(([, value]) => value));
      const hash = `#/logs${asked.size ? `?${asked}` : ""}`;
      // Repeating a search finds newer logs.
      if (hash === location.hash) dispatchEvent(new HashChangeEvent("hashchange"));
      else location.hash = hash;
    };
    return h("search", {}, h("form", { class: "tools", onsubmit: submit },
      h("select", { name: "search", "aria-label": t("find_what") }, ["", ...SEARCHES].map(option)),
      field("robot", { placeholder: "cruiser-*" }), field("reason", { list: "reasons" }), field("operator"),
      field("since", { placeholder: "7d, 2026-01-02" }), field("until"), this.reasons, h("button", {}, t("find_it"))));
  }

  /** One after the other, because the desk answers only two questions at a time. */
  async fill(sections) {
    for (const [search, place] of sections) {
      try {
        const [head, found] = await find(search, this.flags);
        this.reasons.replaceChildren(...head.reasons.map((value) => h("option", { value }, meaningOf(value))));
        this.uncataloged.hidden = head.uncataloged.length === 0;
        const download = (name) => (name.endsWith(".part") ? "" : h("a", { href: `logs/${part(name)}` }, t("download")));
        this.names.replaceChildren(...head.uncataloged.map((name) => h("li", {}, name, " ", h("a", { href: reportOf(name), ...NEW_PAGE }, t("report")), " ", download(name))));
        this.fault.replaceChildren(fault(head.fault));
        place.replaceChildren(head.is_failed ? "" : table(search, found, head.viewers));
      } catch (error) {
        place.replaceChildren(fault(error.message));
      }
    }
  }
}

const fault = (text) => (text ? h("p", { class: "fault", role: "alert", lang: "en" }, text.replaceAll("cruiser review: ", "")) : "");

const cell = (name, kind, ...children) => h("td", { class: kind, "data-label": t(name) }, children);

const secondsOf = (one) => {
  const s = Math.round((one.end_ns - one.start_ns) / 1e9);
  return s < 3600 ? `${Math.floor(s / 60)}:${String(s % 60).padStart(2, "0")}` : `${Math.floor(s / 3600)} h ${Math.floor(s / 60) % 60} min`;
};

const metersOf = ({ distance_m: m, missing_s: missing, gap_s: gap }) => (missing || gap ? "\u2265 " : "") + (m >= 1000 ? `${(m / 1000).toFixed(1)} km` : `${(m ?? 0).toFixed(1)} m`);

/** The cells of each kind of result, as [name, kind, content]. */
const CELLS = {
  logs: (one) => [
    ["robot", "name", one.names.join(", ") || "--"], ["lasted", "number", one.messages ? secondsOf(one) : "--"], ["distance", "number", metersOf(one)],
    ["stops", "number", Object.values(one.stops).reduce((sum, count) => sum + count, 0)], ["samples_lost", "number", one.lost ?? "--"],
    ["what", "what", one.faults ? h("span", { lang: "en" }, one.damage.join("; ")) : ""]],
  drives: (one) => [
    ["robot", "name", one.robot], ["lasted", "number", secondsOf(one)], ["distance", "number", metersOf(one)], ["stops", "number", one.stops], ["what", "what", told(one.text)]],
  moments: (one) => [
    ["robot", "name", one.robot || "--"], ["kind", "", valueOf(one.kind)], ["operator_of", "name", one.operator || (one.holder ? `(${one.holder})` : "--")], ["what", "what", told(one.text)]],
};

function table(search, found, viewers) {
  if (!found.length) return h("p", { class: "soft" }, t("nothing_found"));
  const cells = CELLS[search] ?? CELLS.moments;
  const heads = ["time", ...cells(found[0]).map(([name]) => name), "open_it"];
  const kinds = ["when", ...cells(found[0]).map(([, kind]) => kind), ""];
  return h("table", { class: "fleet found" },
    h("thead", {}, h("tr", {}, heads.map((name, at) => h("th", { scope: "col", class: kinds[at] }, t(name))))),
    h("tbody", {}, found.map((one) => row(one, cells(one), viewers))));
}

function row(one, cells, viewers) {
  const name = nameOf(one.file);
  const moment = one.link?.split(".html#")[1] ?? "";
  const at = new URLSearchParams(moment);
  const level = one.faults ? 2 : one.lost ? 1 : (LEVELS[one.severity] ?? 0);
  const isWhole = !name.endsWith(".part");
  const reason = h("td", { class: "reason", colspan: 9, lang: "en", "aria-live": "polite" });
  const line = h("tr", { hidden: true }, reason);
  const why = async () => {
    line.hidden = false;
    reason.replaceChildren(t("working"));
    try {
      const { headline, chain } = JSON.parse(await ask(`whys/${part(name)}?${new URLSearchParams({ at: at.get("t"), robot: one.robot })}`));
      reason.replaceChildren(h("b", {}, headline), h("dl", { class: "facts" }, chain.map((link) => [h("dt", {}, link.step), h("dd", {}, link.text)])));
    } catch (error) {
      reason.replaceChildren(fault(error.message));
    }
  };
  const time = one.messages === 0 ? "--" : one.time.slice(0, 19);
  const links = h("td", { class: "links" },
    h("a", { href: reportOf(name, moment), ...NEW_PAGE }, t("report")),
    one.why ? h("button", { type: "button", class: "small", onclick: why }, t("why")) : null,
    isWhole ? viewers.map((viewer) => h("a", { href: viewerOf(viewer, name, at.get("t")), ...NEW_PAGE }, `${t("open_in")} ${viewer.name}`)) : null,
    isWhole ? h("a", { href: `logs/${part(name)}` }, t("download")) : null);
  return [h("tr", { class: `row${level}` }, cell("time", "when", time, h("div", { class: "soft file" }, name)), cells.map((all) => cell(...all)), links), line];
}
