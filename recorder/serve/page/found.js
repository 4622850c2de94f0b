// What was found: drives, moments and logs as tables.

import { lastedOf, metersOf, placeOf, timeOf } from "./ask.js";
import { h } from "./elements.js";
import { languageOf, meaningOf, said, t, valueOf } from "./words.js";

const LEVELS = { error: 2, warning: 1 };

/** What a robot or a recorder said, in the language of the page as far as it has words for it. */
export const words = (text) => h("span", { lang: languageOf(text) }, said(text));

const reasonOf = (moment) => (moment.reason === "none" ? "" : meaningOf(moment.reason));

export const tagsOf = (tags) => tags.map((tag) => h("a", { class: "pill tag", href: placeOf.find(`log tag=${tag}`) }, tag));

/** A stop, an incident or another event, as a link to its moment. */
export function momentLine(file, moment) {
  const text = reasonOf(moment) || said(moment.text) || valueOf(moment.kind);
  return h("li", { class: moment.kind === "incident" ? "error" : moment.severity },
    h("a", { href: placeOf.log(file, moment.time, moment.robot) }, moment.time.slice(11, 19)), " ",
    moment.kind === "incident" ? `${valueOf("incident")}: ` : "", text);
}

const head = (...names) => h("thead", {}, h("tr", {}, names.map(([name, kind]) => h("th", { class: kind, scope: "col" }, t(name)))));

const cell = (name, kind, ...children) => h("td", { class: kind, "data-label": t(name) }, children);

const when = (file, time, robot) => cell("begin", "when", h("a", { href: placeOf.log(file, time, robot) }, time ? timeOf(time).slice(0, 19) : file));

function driveRow(one) {
  const listed = one.moments.length ? h("ul", { class: "marks" }, one.moments.map((moment) => momentLine(one.file, moment))) : one.text && words(one.text);
  return h("tr", { class: `row${LEVELS[one.severity] ?? 0}` },
    when(one.file, one.start, one.robot), cell("robot", "name", one.robot), cell("lasted", "number", lastedOf(one.start, one.end)),
    cell("distance", "number", metersOf(one.distance_m)), cell("driver", "", one.drivers.join(", ") || "--"),
    cell("what", "what", listed, one.more_moments ? h("p", { class: "soft" }, `+ ${one.more_moments}`) : null), cell("tags", "", tagsOf(one.tags)));
}

function momentRow(one) {
  return h("tr", { class: `row${LEVELS[one.severity] ?? 0}` },
    when(one.file, one.time, one.robot), cell("robot", "name", one.robot || "--"), cell("kind", "", valueOf(one.kind)),
    cell("driver", "", one.operator || "--"), cell("what", "what", words(one.text)), cell("tags", "", tagsOf(one.tags)));
}

function logRow(one) {
  const stops = Object.values(one.stops).reduce((sum, count) => sum + count, 0);
  return h("tr", { class: `row${one.faults ? 2 : one.lost ? 1 : 0}` },
    when(one.file, one.start), cell("robot", "name", one.robots.join(", ")), cell("lasted", "number", one.start ? lastedOf(one.start, one.end) : "--"),
    cell("distance", "number", metersOf(one.distance_m)), cell("driver", "", one.operators.join(", ") || "--"),
    cell("stops", "number", stops), cell("samples_lost", "number", one.lost ?? "--"), cell("tags", "", tagsOf(one.tags)));
}

const KINDS = {
  drives: [driveRow, [["begin"], ["robot"], ["lasted", "number"], ["distance", "number"], ["driver"], ["what", "what"], ["tags"]]],
  moments: [momentRow, [["time"], ["robot"], ["kind"], ["operator_of"], ["what", "what"], ["tags"]]],
  logs: [logRow, [["begin"], ["robot"], ["lasted", "number"], ["distance", "number"], ["driver"], ["stops", "number"], ["samples_lost", "number"], ["tags"]]],
};

/** An answer as a table; what is left out is said. */
export function foundTable({ subject, total, answers }) {
  if (!answers.length) return h("p", { class: "soft" }, t("nothing_found"));
  const [row, names] = KINDS[subject];
  return h("div", {},
    h("p", { class: "soft" }, total > answers.length ? `${t("newest")} ${answers.length} / ${total}` : `${total}`, " · UTC"),
    h("table", { class: "fleet found" }, head(...names), h("tbody", {}, answers.map(row))));
}
