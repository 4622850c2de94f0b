// The panel to drive a robot: operator, lease, hold to drive.

import { Control } from "./control.js";
import { h, setText } from "./elements.js";
import { Held } from "./held.js";
import * as keys from "./operator.js";
import { cureOf, meaningOf, said, t } from "./words.js";

const ANGLE_DEG = 24;
const HORN_MS = 600;
const SPEEDS = { min: "0.1", max: "2.2", step: "0.1" };
const NAME = /^[A-Za-z0-9_.-]{1,64}$/;

/** The name under which this browser commands in open mode, and stops in any mode: generated, until a user types one. */
export function operatorName() {
  // Another page of this address may have stored anything: a stop must not fail for a name.
  const name = localStorage.getItem("operator") ?? "";
  if (NAME.test(name)) return name;
  localStorage.setItem("operator", `desk-${Array.from(crypto.getRandomValues(new Uint8Array(2)), (byte) => byte.toString(16).padStart(2, "0")).join("")}`);
  return localStorage.getItem("operator");
}

export class DrivePanel {
  constructor(robot, link, hello) {
    Object.assign(this, { robot, link, hello });
    this.control = this.held = this.signer = null;
    this.lit = this.left = false;
    const button = (text, act) => h("button", { type: "button", onclick: () => this.attempt(act) }, text);
    this.take = button(t("take_control"), () => this.begin("acquire"));
    this.takeOver = button(t("take_over"), () => this.begin("take", this.may("override") ? { override: true } : {}));
    this.giveBack = button(t("give_back"), () => this.control.release());
    this.reset = button(t("reset"), () => this.clear());
    this.buttons = h("div", { class: "tools" }, this.reset, this.take, this.takeOver, this.giveBack); // for the band above all
    this.lights = button(t("lights"), () => this.light(!this.lit));
    this.horn = button(t("sound_horn"), () => this.sound());
    this.speed = h("input", { type: "range", ...SPEEDS, value: localStorage.getItem("speed") ?? "0.5", "aria-label": t("top_speed"), oninput: () => this.showSpeed() });
    this.speedText = h("output", { class: "number" });
    this.padText = h("span");
    this.pad = h("div", { class: "pad", tabindex: "0", role: "button" }, this.padText);
    this.note = h("p", { role: "status" });
    this.who = h("span", { class: "soft" });
    this.name = h("input", { value: operatorName(), maxlength: "64", onchange: () => this.rename() });
    this.named = h("label", {}, `${t("your_name")} `, this.name);
    this.keys = keysBox(() => this.showWho());
    this.element = h("section", { class: "card wide drive" }, h("h2", {}, t("control")),
      h("div", { class: "tools" }, this.who, this.named, this.lights, this.horn,
        h("label", {}, `${t("top_speed")} `, this.speed, " ", this.speedText), this.keys),
      this.note, h("div", { class: "hands" }, this.pad, h("p", { class: "soft" }, t("hold"))));
    this.showSpeed();
    this.showWho();
    this.update(null);
  }

  showSpeed() {
    localStorage.setItem("speed", this.speed.value);
    setText(this.speedText, `${this.speed.value} m/s`);
  }

  async showWho() {
    this.signer = await keys.signer().catch(() => null);
    this.named.hidden = this.signer !== null;
    setText(this.who, this.signer ? this.rights() : t("open_mode"));
    this.update(this.safety);
  }

  rename() {
    if (!NAME.test(this.name.value)) return setText(this.note, t("name_form"));
    localStorage.setItem("operator", this.name.value);
    localStorage.setItem("operator_asked", "yes");
    setText(this.note, "");
  }

  /** Ask once for the driver's name, which others see and logs contain; a second press accepts it. */
  asksName() {
    if (this.signer || localStorage.getItem("operator_asked")) return false;
    localStorage.setItem("operator_asked", "yes");
    setText(this.note, t("ask_name", this.ownName));
    this.name.focus();
    this.name.select();
    return true;
  }

  /** The operator who signs, and the rights of the grant. */
  rights() {
    const { role, verbs, speed_limit_mps: limit, not_after: end } = keys.grantOf(this.signer);
    const until = new Date(1000 * end).toLocaleString([], { dateStyle: "short", timeStyle: "short" });
    return [`${t("signed_as")} ${this.signer.name}`, t(verbs.includes("drive") ? role : "maintainer"), limit && `${t("at_most")} ${limit} m/s`, `${t("until")} ${until}`].filter(Boolean).join(", ");
  }

  /** Does the grant allow this? In open mode the robot decides. */
  may(verb) {
    if (this.signer === null) return verb !== "override";
    const grant = keys.grantOf(this.signer);
    return verb === "override" ? grant.override : grant.verbs.includes(verb);
  }

  get isDriver() {
    return this.may("drive") && this.may("engage");
  }

  /** Reset the latches, and only the stop of the operator whom the button names. */
  async clear() {
    const of = this.stopper;
    await (await this.newControl()).reset(of);
  }

  async sound() {
    const { control } = this;
    await control.ask("horn", { lease: control.lease, on: true });
    await new Promise((resolve) => setTimeout(resolve, HORN_MS));
    if (control.driving) await control.ask("horn", { lease: control.lease, on: false });
  }

  async light(headlamp) {
    await this.control.ask("light", { lease: this.control.lease, headlamp });
    this.lit = headlamp;
  }

  async newControl() {
    this.control?.end("", "");
    this.signer = await keys.signer().catch(() => null);
    if (this.left) throw new Error("given up");
    this.control = new Control(this.link, this.hello(), this.robot, this.ownName, this.signer);
    return this.control;
  }

  async begin(verb, more = {}) {
    this.signer ??= await keys.signer().catch(() => null);
    if (this.asksName()) return;
    const control = await this.newControl();
    const held = new Held(this.pad, () => control.driving && control.tick());
    this.held = held;
    control.onsleep = () => held.letGo();
    control.onend = (reason, detail) => {
      held.end();
      this.pad.classList.remove("held");
      setText(this.note, [t("ended"), reason ? `${meaningOf(reason)}${detail && ` (${said(detail)})`}` : said(detail)].filter(Boolean).join(": "));
      this.update(this.safety);
    };
    await control.begin(verb, more);
    // What was held before the robot was engaged counts only when it is pressed again.
    held.letGo();
    control.wish = () => {
      const wish = held.wish();
      this.pad.classList.toggle("held", wish !== null);
      const speed = Number(this.speed.value);
      return wish && { speed: wish.forward * speed, angle: wish.left * ANGLE_DEG };
    };
    setText(this.note, t("you_drive"));
    this.pad.focus();
  }

  async attempt(act) {
    if (this.working) return;
    this.working = true;
    setText(this.note, t("working"));
    this.update(this.safety);
    try {
      await act();
      if (this.note.textContent === t("working")) setText(this.note, "");
    } catch (error) {
      const unproven = error.reason === "proof_missing";
      setText(this.note, unproven ? t("needs_key") : this.inWords(error));
      if (unproven && !this.signer) setText(this.who, t("sees"));
    }
    this.working = false;
    this.update(this.safety);
  }

  /** Why something was not done; for a refusal with its cure. */
  inWords({ message, reason, cure }) {
    return [said(message), reason && cureOf(reason, cure, this.robot)].filter(Boolean).join(t("stop_mark"));
  }

  receiveState(sample) {
    this.control?.receiveState(sample);
  }

  /** May it be shown as the robot's state? */
  async believes(sample) {
    return this.control?.believes(sample) ?? true;
  }

  /** The name in this page: other pages of this browser may have others. */
  get ownName() {
    return this.signer ? this.signer.name : NAME.test(this.name.value) ? this.name.value : operatorName();
  }

  get driving() {
    return this.control?.driving ?? false;
  }

  /** Show the available actions. @param safety the arbiter's state; null if none is current. */
  update(safety) {
    this.safety = safety;
    const { driving } = this;
    const holder = safety?.lease_holder ?? "";
    const idle = safety !== null && !this.working && !driving;
    this.take.disabled = !idle;
    this.take.hidden = !this.isDriver || driving || holder !== "" || Boolean(safety?.latched.length);
    this.takeOver.hidden = driving || holder === "" || !this.may("take");
    this.takeOver.disabled = !idle;
    setText(this.takeOver, `${t("take_over")} ${holder}`);
    this.giveBack.disabled = this.lights.disabled = this.horn.disabled = !driving || this.working;
    this.giveBack.hidden = this.lights.hidden = this.horn.hidden = !driving;
    this.lights.setAttribute("aria-pressed", String(this.lit));
    this.stopper = safety?.stopped_by?.find((name) => name !== this.ownName);
    setText(this.reset, this.stopper ? t("reset_of", this.stopper) : t("reset"));
    this.reset.hidden = !safety?.latched.length || !this.may("reset");
    this.reset.disabled = !idle || safety.state === "stopping";
    this.pad.classList.toggle("live", driving);
    setText(this.padText, t(driving ? "pad" : "no_pad"));
    this.pad.setAttribute("aria-disabled", String(!driving));
  }

  /** The page shows something else: stop driving, and release the lease. */
  end() {
    this.left = true;
    this.control?.release();
    this.held?.end();
  }
}

/** Make a key, save its request, load the bundle. */
function keysBox(changed) {
  const note = h("p", { role: "status" });
  const attempt = (act) => async () => {
    try {
      setText(note, (await act()) ?? "");
    } catch (error) {
      setText(note, said(error.message));
    }
    changed();
  };
  const save = attempt(async () => {
    const name = operatorName();
    const [request, fingerprint] = await keys.requestFor(name);
    const file = new Blob([request], { type: "application/json" });
    const anchor = h("a", { href: URL.createObjectURL(file), download: `operator-${name}.request` });
    anchor.click();
    URL.revokeObjectURL(anchor.href);
    return `${t("request")} ${fingerprint}: ${t("compare_request")}`;
  });
  // A loaded bundle is accepted after the user has compared its authority.
  let loaded = null;
  const take = h("button", { type: "button", hidden: true, onclick: attempt(async () => {
    take.hidden = true;
    await keys.install(loaded);
  }) }, t("take_over_bundle"));
  const load = h("input", { type: "file", accept: ".bundle", "aria-label": t("load_bundle"), onchange: attempt(async () => {
    take.hidden = true;
    const text = await load.files[0].text();
    load.value = ""; // else a file of the same name, another bundle maybe, would load nothing
    const [bundle, request] = await keys.answerOf(text);
    const shown = `${bundle.name}: ${t("request")} ${request}, ${t("authority")} ${bundle.fingerprint}`;
    if (await keys.isKnown(bundle)) {
      await keys.install(bundle);
      return shown;
    }
    [loaded, take.hidden] = [bundle, false];
    return `${shown}. ${t("compare_authority")}`;
  }) });
  const box = h("details", {}, h("summary", {}, t("keys")), h("p", {}, isSecureContext ? t("key_help") : t("insecure")),
    h("button", { type: "button", onclick: save, disabled: !isSecureContext }, t("save_request")), " ",
    h("label", {}, `${t("load_bundle")} `, load), " ", take, " ",
    h("button", { type: "button", onclick: attempt(async () => { await keys.forget(); }) }, t("forget")), note);
  return box;
}
