// The page of a log: its drives and events, its report, reasons, a part of it, viewers, and what people say of it.

import { ask, lastedOf, metersOf, placeOf, shifted, timeOf, viewerOf } from "./ask.js";
import { tagsOf, words } from "./found.js";
import { h, number, setText } from "./elements.js";
import { meaningOf, said, t, valueOf } from "./words.js";

const AROUND_S = 5;
const NEW_PAGE = { target: "_blank", rel: "noopener" };

export class LogPage {
  constructor(file, moment, state) {
    this.file = file;
    this.moment = moment;
    this.state = state;
    this.element = h("div", { class: "log" }, h("h1", {}, file), h("p", { class: "soft" }, t("working")));
    this.update();
  }

  get title() {
    return this.file;
  }

  async update() {
    let found;
    try {
      found = await ask(`api/logs/${encodeURIComponent(this.file)}`);
    } catch (error) {
      this.element.replaceChildren(h("h1", {}, this.file), h("p", { class: "fault", role: "alert", lang: "en" }, error.message));
      return;
    }
    // What somebody is writing stays where it is.
    if (this.isCataloged === Boolean(found.catalog)) return;
    this.isCataloged = Boolean(found.catalog);
    this.notes = new Notes(this.file, this.moment, this.state().can_write, found);
    const log = found.catalog;
    this.element.replaceChildren(...[
      h("h1", {}, found.file),
      this.tools(found),
      this.moment.t ? this.momentCard() : null,
      log ? this.facts(log) : h("p", { class: "card" }, t(found.is_open ? "being_written" : "not_cataloged")),
      log ? this.happenings(log) : null,
      this.cutCard(log),
      this.notes.element,
    ].filter(Boolean));
  }

  tools(found) {
    const { t: time, robot } = this.moment;
    const viewers = this.state().viewers ?? [];
    return h("p", { class: "tools links" },
      h("a", { class: "button", href: placeOf.report(this.file, time, robot), ...NEW_PAGE }, t("report")),
      found.is_open ? null : h("a", { class: "button", href: placeOf.download(this.file) }, t("download")),
      found.is_open ? null : viewers.map((one) => h("a", { class: "button", href: viewerOf(one, this.file, time), ...NEW_PAGE }, `${t("open_in")} ${one.name}`)));
  }

  momentCard() {
    const { t: time, robot } = this.moment;
    const why = new Why(this.file);
    return h("section", { class: "card", id: "moment", "aria-label": t("this_moment") }, h("h2", {}, `${robot} ${timeOf(time)} UTC`),
      h("p", { class: "tools" }, h("button", { type: "button", onclick: () => why.ask(time, robot) }, t("why_then"))), why.element);
  }

  facts(log) {
    const fact = (name, value) => [h("dt", {}, t(name)), h("dd", {}, value)];
    const drivers = log.drivers.map((one) => `${one.name} (${one.robot}, ${metersOf(one.distance_m)})`).join(", ");
    return h("section", { class: "card", "aria-label": t("facts_of_log") },
      h("dl", { class: "facts" },
        fact("begin", log.start ? `${timeOf(log.start)} UTC` : "--"), fact("lasted", log.start ? lastedOf(log.start, log.end) : "--"),
        fact("robot", log.robots.join(", ") || "--"), fact("driver", drivers || t("nobody")), fact("distance", metersOf(log.distance_m)),
        fact("highest_speed", number(log.top_mps, 2, "m/s")), fact("samples_lost", log.lost ?? "--"), fact("refused_requests", log.refused),
        fact("size", `${(log.bytes / 1e6).toFixed(1)} MB`), log.damage.length ? fact("damage", h("span", { lang: "en" }, log.damage.join("; "))) : null,
        log.is_whole ? null : fact("damage", t("not_whole"))));
  }

  /** Drives, and below them every event, each a link to its moment. */
  happenings(log) {
    const time = (one, robot) => h("a", { href: placeOf.log(this.file, one, robot) }, timeOf(one).slice(11));
    const drive = (one) => h("li", {}, time(one.start, one.robot), ` ${one.robot} · ${lastedOf(one.start, one.end)} · ${metersOf(one.distance_m)} · ${one.drivers.join(", ") || "--"} · ${t("stops")}: ${one.stops}`);
    const moment = (one) => h("li", { class: one.kind === "incident" ? "error" : one.severity }, time(one.time, one.robot), ` ${one.robot} `, h("span", { class: "soft" }, valueOf(one.kind)), " ",
      words(one.text), one.reason === "none" || said(one.text).includes(meaningOf(one.reason)) ? "" : ` (${meaningOf(one.reason)})`, one.operator ? ` · ${one.operator}` : "");
    return h("section", { class: "card", "aria-label": t("events") },
      h("h2", {}, t("drives")), h("ul", { class: "events", tabindex: "0", "aria-label": t("drives") }, log.all_drives.map(drive)),
      h("h2", {}, t("events")), h("ul", { class: "events", tabindex: "0", "aria-label": t("events") }, log.moments.map(moment)),
      log.more_moments ? h("p", { class: "soft" }, `+ ${log.more_moments}`) : null);
  }

  cutCard(log) {
    const begin = this.moment.t ? shifted(this.moment.t, -AROUND_S) : log?.start || "";
    const end = this.moment.t ? shifted(this.moment.t, AROUND_S) : begin && shifted(begin, 2 * AROUND_S);
    const input = (name, value) => h("input", { type: "text", name, value, maxlength: 40, oninput: () => aim() });
    const [from, to] = [input("from", begin), input("to", end)];
    const form = h("select", { name: "as", "aria-label": t("as_what"), onchange: () => aim() }, (this.state().forms ?? ["mcap"]).map((one) => h("option", { value: one }, one === "mcap" ? "MCAP" : one)));
    const link = h("a", { class: "button", ...NEW_PAGE }, t("cut_out"));
    const aim = () => link.setAttribute("href", placeOf.cut(this.file, from.value.trim(), to.value.trim(), form.value));
    aim();
    return h("section", { class: "card", "aria-label": t("cut") }, h("h2", {}, t("cut")),
      h("p", { class: "tools" }, h("label", {}, t("from_time"), from), h("label", {}, t("to_time"), to), form, link),
      h("p", { class: "soft" }, t("cut_help")));
  }
}

/** The chain of reasons of a moment, once it is asked for. */
class Why {
  constructor(file) {
    this.file = file;
    this.element = h("div", { "aria-live": "polite" });
  }

  async ask(time, robot) {
    this.element.replaceChildren(h("p", { class: "soft" }, t("working")));
    try {
      const answer = await ask(`api/why/${encodeURIComponent(this.file)}?at=${encodeURIComponent(time)}&robot=${encodeURIComponent(robot)}`);
      this.element.replaceChildren(h("div", { class: "chain", lang: "en" }, h("p", {}, h("b", {}, answer.headline)),
        h("dl", { class: "facts" }, answer.chain.map((one) => [h("dt", {}, one.from_at_s === null ? one.step : `${one.from_at_s.toFixed(3)} s ${one.step}`), h("dd", {}, one.text)]))));
    } catch (error) {
      this.element.replaceChildren(h("p", { class: "fault", role: "alert", lang: "en" }, error.message));
    }
  }
}

/** Tags and comments; they can be written where the server allows it. */
class Notes {
  constructor(file, moment, canWrite, found) {
    this.file = file;
    this.moment = moment;
    this.canWrite = canWrite;
    this.tags = h("p", { class: "tools tags" });
    this.list = h("ul", { class: "events notes", tabindex: "0", "aria-label": t("notes") });
    this.fault = h("p", { class: "fault", role: "alert" });
    this.element = h("section", { class: "card", "aria-label": t("notes") }, h("h2", {}, t("notes")), this.tags, canWrite ? this.form() : null, this.fault, this.list);
    this.show(found);
  }

  show({ notes, tags, unread_notes: unread }) {
    const off = (tag) => h("button", { class: "small", type: "button", onclick: () => this.send({ is: "tag", tag, off: true }) }, `${t("take_off")} ${tag}`);
    this.tags.replaceChildren(...(tags.length ? tagsOf(tags).flatMap((one, at) => [one, ...(this.canWrite ? [off(tags[at])] : [])]) : [h("span", { class: "soft" }, t("no_tags"))]));
    const about = (one) => (one.at ? [" ", h("a", { href: placeOf.log(this.file, one.at, one.robot) }, timeOf(one.at))] : "");
    const text = (one) => (one.is === "tag" ? `${t(one.off ? "tag_off" : "tag_on")} ${one.tag}` : h("span", { class: "comment" }, one.text));
    this.list.replaceChildren(...(notes.length ? notes.map((one) => h("li", {}, h("b", {}, one.who), " ", h("span", { class: "soft" }, timeOf(one.time)), about(one), ": ", text(one))) : [h("li", { class: "soft" }, t("no_notes"))]));
    setText(this.fault, unread ? `${t("unread_notes")} ${unread}` : "");
  }

  form() {
    this.who = h("input", { name: "who", maxlength: 64, autocomplete: "name", value: localStorage.getItem("author") ?? "" });
    this.text = h("textarea", { name: "text", rows: 3, maxlength: 2000, "aria-label": t("comment") });
    this.tag = h("input", { name: "tag", maxlength: 40, autocomplete: "off" });
    const { t: at, robot } = this.moment;
    this.about = h("input", { type: "checkbox", checked: Boolean(at) });
    const comment = () => this.text.value.trim() && this.send({ is: "comment", text: this.text.value.trim(), ...(at && this.about.checked ? { at, robot } : {}) }, this.text);
    const put = () => this.tag.value.trim() && this.send({ is: "tag", tag: this.tag.value.trim() }, this.tag);
    return h("div", {},
      h("p", { class: "tools" }, h("label", {}, t("your_name"), this.who), h("span", { class: "soft" }, t("names_unchecked"))),
      h("form", { class: "tools", onsubmit: (event) => { event.preventDefault(); put(); } }, h("label", {}, t("tag"), this.tag), h("button", {}, t("put_on"))),
      h("form", { class: "tools", onsubmit: (event) => { event.preventDefault(); comment(); } }, this.text,
        at ? h("label", {}, this.about, timeOf(at)) : null, h("button", {}, t("add_comment"))));
  }

  async send(note, field) {
    const who = this.who.value.trim();
    if (!who) {
      setText(this.fault, t("name_first"));
      this.who.focus();
      return;
    }
    localStorage.setItem("author", who);
    try {
      this.show(await ask(`api/notes/${encodeURIComponent(this.file)}`, { method: "POST", body: JSON.stringify({ ...note, who }) }));
      if (field) field.value = "";
    } catch (error) {
      setText(this.fault, error.message);
    }
  }
}
