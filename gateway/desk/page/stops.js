// The remote stop, and its outcome as far as it is known.

import { h } from "./elements.js";
import { said, t } from "./words.js";

const OUTCOME_MS = 10_000; // what a desk takes to find out what came of a stop, at most

export class Stops {
  constructor(link, element, fleet) {
    this.link = link;
    this.fleet = fleet;
    this.element = element;
    this.waiting = new Map(); // robot -> timer, of stops whose outcome has not come
    link.on("stopped", (outcome) => this.show(outcome));
    link.on("refused", ({ stop, fault }) => typeof stop === "string" && this.unknown(stop, fault));
    link.on("closed", () => [...this.waiting.keys()].forEach((robot) => this.unknown(robot, t("no_desk"))));
  }

  /** Stop a robot, or all with an empty name. Needs no right to drive. */
  stop(robot, operator) {
    const whom = robot || t("everyone");
    const sent = this.link.send({ is: "stop", robot, operator });
    this.card(robot, sent ? 1 : 2, h("b", {}, sent ? `${t("stopping_now")} ${whom} …` : `${t("not_sent")} (${whom})`));
    if (sent) this.waiting.set(robot, setTimeout(() => this.unknown(robot, t("no_outcome")), OUTCOME_MS));
  }

  /** The outcome of a stop did not arrive: a person has to look. */
  unknown(robot, why) {
    this.card(robot, 2, h("b", {}, `${t("stop_outcome")}: ${robot || t("everyone")}`), h("ul", {}, [why, t("use_button")].map((row) => h("li", {}, row))));
  }

  show({ robot, standing, refused, unconfirmed, silent, counted }) {
    const rows = [
      // A robot that reads zero before it has moved may stop, but nothing shows it.
      ...Object.entries(refused).map(([name, text]) => `${name}: ${t(text.startsWith("not_confirmed") ? "unconfirmed" : "refused")}: ${said(text)}`),
      ...Object.entries(unconfirmed).map(([name, text]) => `${name}: ${t("unconfirmed")}: ${said(text)}`),
      ...this.unheard(robot, standing, refused, unconfirmed, silent).map((name) => `${name}: ${t("silent_robot")}`),
    ];
    if (rows.length + standing.length === 0) rows.push(t("nobody_replied"));
    if (!counted) rows.push(t("uncounted"));
    const bad = rows.length > 0;
    if (bad) rows.push(t("use_button"));
    rows.push(...standing.map((name) => `${name}: ${t("standing")}`));
    // With its time: the card stays until it is closed, and robots may have been reset since.
    this.card(robot, bad ? 2 : 0, h("b", {}, `${t("stop_outcome")}: ${robot || t("everyone")}, ${new Date().toLocaleTimeString()}`), h("ul", {}, rows.map((row) => h("li", {}, row))));
  }

  /** Robots that should have replied: connected ones, and those on the page. */
  unheard(robot, standing, refused, unconfirmed, silent) {
    const known = robot ? [robot] : [...this.fleet.rows.keys()];
    const heard = new Set([...standing, ...Object.keys(refused), ...Object.keys(unconfirmed)]);
    return [...new Set([...silent, ...known])].filter((name) => !heard.has(name));
  }

  card(robot, level, ...children) {
    clearTimeout(this.waiting.get(robot));
    this.waiting.delete(robot);
    const id = `stop-of-${robot}`;
    document.getElementById(id)?.remove();
    const card = h("div", { id, class: `card level${level}` }, ...children, h("button", { class: "quiet", type: "button", onclick: () => card.remove() }, t("close")));
    this.element.prepend(card);
  }
}
