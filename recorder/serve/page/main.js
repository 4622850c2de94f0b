// The page: which of its views is shown, and the state of the catalog.

import { ask } from "./ask.js";
import { setText } from "./elements.js";
import { LogPage } from "./log.js";
import { DayPage, SearchPage } from "./search.js";
import { changeLanguage, language, learnReasons, t } from "./words.js";

const READING_MS = 1000;
const IDLE_MS = 5000;

const byId = (id) => document.getElementById(id);
let state = {};
let view = null;

function viewOf(hash) {
  const [, kind, rest = ""] = /^#\/(find|day|log)\/(.*)$/.exec(hash) ?? [];
  try {
    if (kind === "find") return new SearchPage(decodeURIComponent(rest));
    if (kind === "day" && /^\d{4}-\d\d-\d\d$/.test(rest)) return new DayPage(rest);
    if (kind === "log") {
      const [file, query] = rest.split("?");
      const asked = new URLSearchParams(query);
      const time = asked.get("t") ?? "";
      const moment = { t: Number.isNaN(Date.parse(time)) ? "" : time, robot: asked.get("robot") ?? "" };
      return new LogPage(decodeURIComponent(file), moment, () => state);
    }
  } catch (error) {
    if (!(error instanceof URIError)) throw error;
  }
  return new SearchPage("");
}

function route() {
  view = viewOf(location.hash);
  byId("view").replaceChildren(view.element);
  document.title = `${view.title ? `${view.title} · ` : ""}Cruiser`;
}

function write() {
  document.documentElement.lang = language();
  for (const element of document.querySelectorAll("[data-t]")) setText(element, t(element.dataset.t));
  setText(byId("language"), t("other_language"));
  showState();
}

function showState() {
  const element = byId("state");
  const { fault, is_reading: reading, cataloged, logs } = state;
  element.className = `pill level${state.lost ? 2 : fault || reading ? 1 : 0}`;
  element.title = fault ?? "";
  const count = `${cataloged ?? 0}`;
  setText(element, fault ? (state.lost ? fault : `${count} · ${fault.replace(/^cruiser review: /, "")}`) : reading ? `${t("reading_logs")} ${count} / ${logs}` : `${count} ${t("logs_found")}`);
}

async function look() {
  const before = state;
  try {
    state = await ask("api/state");
    learnReasons(state.reasons);
  } catch (error) {
    state = { ...state, fault: error.message, lost: true, is_reading: false };
  }
  showState();
  if (view === null) route();
  else if (before.cataloged !== state.cataloged && !state.lost) view.update();
  setTimeout(look, state.is_reading ? READING_MS : IDLE_MS);
}

byId("language").addEventListener("click", () => {
  changeLanguage();
  write();
  route();
});
addEventListener("hashchange", () => {
  route();
  // The link that led here is gone: whoever has no mouse goes on from the top.
  scrollTo(0, 0);
  byId("view").focus({ preventScroll: true });
});
write();
look();
