// The page: which view is shown, and where messages go.

import { FRESH_MS } from "./contact.js";
import { DrivePanel, operatorName } from "./drive.js";
import { setText } from "./elements.js";
import { Link } from "./link.js";
import { LogsPage } from "./logs.js";
import { Overview } from "./overview.js";
import { RobotPage } from "./robot.js";
import { Stops } from "./stops.js";
import { changeLanguage, language, learnReasons, t } from "./words.js";

const LOOK_MS = 100;
const LOST = { isOwn: true, level: 2, word: "offline", text: "", driver: "", speed_mps: null, limit_mps: null, link_age_s: null, lost: null, event: "", acknowledged: "", reasons: [] };

const byId = (id) => document.getElementById(id);
const fleet = { rows: new Map(), recorders: [], linked: false };
const link = new Link();
const stops = new Stops(link, byId("stops"), fleet);
const kept = new Map(); // the rows as they were when nothing came any more: a desk that goes on sends only what has changed
let hello = null;
let view = null;

const shownRobot = () => /^#\/(?:robot|kiosk)\/([a-z0-9-]+)$/.exec(location.hash)?.[1] ?? "";

function route() {
  view?.end?.();
  const robot = shownRobot();
  if (robot) view = new RobotPage(robot, fleet, new DrivePanel(robot, link, () => hello));
  else view = location.hash.startsWith("#/logs") ? new LogsPage(location.hash) : new Overview(fleet, link, location.hash === "#/wall");
  byId("view").replaceChildren(view.element);
  view.begin?.();
  byId("stop-one").hidden = !robot;
  setText(byId("stop-one"), `${t("stop")} ${robot}`);
  setText(byId("where"), robot);
  document.body.classList.toggle("kiosk", location.hash.startsWith("#/kiosk/"));
  showTitle();
  link.send({ is: "look", robot });
}

/** Show the number of unacknowledged alarms in the page's title, which other tabs show too. */
function showTitle() {
  const unseen = [...fleet.rows.values()].filter((row) => row.level === 2 && !row.acknowledged).length;
  const title = `${unseen ? `(${unseen}) ` : ""}${shownRobot() ? `${shownRobot()} · ` : ""}Cruiser`;
  if (document.title !== title) document.title = title;
}

function write() {
  document.documentElement.lang = language();
  for (const element of document.querySelectorAll("[data-t]")) setText(element, t(element.dataset.t));
  setText(byId("language"), t("other_language"));
  setText(byId("stop-all"), t("stop_all"));
  showLink();
}

/** Check for messages by this page's clock; without any, no row is shown as current. */
function showLink() {
  const isLost = link.silentMs > FRESH_MS;
  const good = !isLost && fleet.linked;
  byId("link").className = `pill level${good ? 0 : 2}`;
  setText(byId("link"), t(good ? "linked" : "not_linked"));
  if (isLost) loseRows();
  if (view instanceof Overview) view.showContact(isLost ? t("desk_lost", (link.silentMs / 1000).toFixed(1)) : fleet.linked ? "" : t("unlinked"));
}

/** Keep the names of all robots, as offline: a restarted desk may not know all of them. */
function loseRows() {
  const known = [...fleet.rows].filter(([, row]) => row.word !== "offline");
  if (known.length === 0) return;
  for (const [robot, row] of known) {
    kept.set(robot, row);
    fleet.rows.set(robot, { ...row, ...LOST });
  }
  showTitle();
  if (view instanceof Overview) view.update();
}

link.on("hello", (message) => {
  hello = message;
  learnReasons(message.reasons);
  byId("logs").hidden = !message.has_logs;
  kept.clear(); // a new connection begins with all rows
  link.send({ is: "look", robot: shownRobot() });
});
link.on("rows", ({ rows, recorders, linked, full }) => {
  for (const [robot, row] of kept) fleet.rows.set(robot, row);
  kept.clear();
  for (const [robot, row] of Object.entries(rows)) {
    if (row === null) fleet.rows.delete(robot);
    else fleet.rows.set(robot, row);
  }
  fleet.recorders = recorders ?? fleet.recorders;
  fleet.linked = linked;
  fleet.full = full;
  showLink();
  showTitle();
  if (view instanceof Overview) view.update();
});
const ofShown = (handle) => (message) => view instanceof RobotPage && view.name === (message.robot ?? shownRobot()) && handle(message);
link.on("sample", ofShown((sample) => sample.key.endsWith(`/${view.name}/${sample.subject}`) && view.receiveSample(sample)));
link.on("history", ofShown((history) => view.receiveHistory(history, hello)));
link.on("pose", ofShown((pose) => view.receivePose(pose)));
link.on("why", ofShown((why) => view.receiveWhy(why)));
link.on("refused", ({ fault }) => console.warn(fault));
link.on("closed", loseRows);
setInterval(showLink, LOOK_MS);

byId("stop-all").addEventListener("click", () => stops.stop("", operatorName()));
byId("stop-one").addEventListener("click", () => stops.stop(shownRobot(), operatorName()));
byId("language").addEventListener("click", () => {
  changeLanguage();
  write();
  route();
});
addEventListener("keydown", (event) => {
  if (event.key === "Escape" && shownRobot()) stops.stop(shownRobot(), operatorName());
});
addEventListener("hashchange", () => {
  route();
  // The link that led here is gone: the keyboard focus goes to the top.
  scrollTo(0, 0);
  byId("view").focus({ preventScroll: true });
});
write();
route();
