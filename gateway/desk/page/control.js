// One robot, commanded by one operator: the lease, verbs, and the stream of drive commands. Independent of the page.

import { Lease, Robot, isAhead, random, runOf } from "./proof.js";

const PERIOD_MS = 20; // 50 drive commands a second
const FRESH_MS = 300; // of a state whose challenge is echoed: as long as the deadman
const LOST_MS = 1000; // the robot stopped by its deadman long ago: the driver must start again
const ASLEEP_MS = 250; // after a longer period the page was frozen, and held keys do not count
const RENEW_MS = 500; // a lease expires after 2 s
const STOP_MS = 10_000; // what a stop takes, at most
const SIGNED = ["safety/state", "state"];
const NOTHING = new Uint8Array();

const { encode, decode } = MessagePack;

export class Refusal extends Error {
  constructor(answer) {
    super(answer.detail);
    this.reason = answer.reason;
    this.cure = answer.cure;
  }
}

export class Control {
  /**
   * @param link the WebSocket to the desk.
   * @param hello the desk's first message.
   * @param robot its name.
   * @param name the operator's, in open mode.
   * @param signer key and grant; null in open mode.
   */
  constructor(link, hello, robot, name, signer) {
    Object.assign(this, { link, hello, robot, signer });
    this.name = signer?.name ?? name;
    this.lease = this.proof = this.met = this.run = null;
    this.state = null; // the newest safety/state that is believed
    this.stateMs = -Infinity;
    this.sequence = 0;
    this.wish = () => null; // {speed, angle} of what is held down; null for nothing
    this.onend = () => {};
    this.driving = false;
    this.over = false; // the driver has given up
    this.shown = {}; // the newest sequence that was believed, by subject
  }

  /** May it be shown? While this page drives in signed mode: only new states that the robot signed in this run. */
  async believes({ subject, key, encoding, payload, attachment }) {
    if (!this.signer || !this.driving || !SIGNED.includes(subject)) return true;
    if (!(await this.met.isPublication({ key, encoding, payload }, attachment, this.run))) return false;
    const { sequence } = decode(payload);
    if (!isAhead(sequence, this.shown[subject])) return false;
    this.shown[subject] = sequence;
    return true;
  }

  key(verb) {
    return `${this.hello.root}/${this.robot}/@cmd/${this.name}/${verb}`;
  }

  /** Process a sample of `safety/state`; in signed mode only if the robot signed it in this run. */
  async receiveState({ key, encoding, payload, attachment }) {
    if (this.signer) {
      if (!this.met || !(await this.met.isPublication({ key, encoding, payload }, attachment, this.run))) return;
    }
    const state = decode(payload);
    if (this.signer && !isAhead(state.sequence, this.state?.sequence)) return;
    this.state = state;
    this.stateMs = performance.now();
    if (this.driving && this.wasEngaged && !state.engaged) this.end(state.stop_reason, state.stop_detail);
    this.wasEngaged ||= this.driving && state.engaged && state.lease_holder === this.name;
  }

  /** Send the robot the grant. Its reply proves its identity and its run. */
  async meet() {
    if (!this.signer) return;
    const question = random(16);
    const statement = new TextEncoder().encode(this.signer.statement);
    const key = `${this.hello.root}/${this.robot}/@auth`;
    let why = new Error(`${this.robot}: no reply`);
    for (const reply of await this.link.ask({ is: "show", robot: this.robot, statement, question })) {
      try {
        const answer = decode(reply.payload);
        const met = await Robot.ofChain(answer.own ?? "", this.robot, this.signer.authority);
        const message = { key, encoding: this.hello.statement_reply, payload: reply.payload };
        if (!(await met.isReply(message, reply.attachment, question))) throw new Error("the reply is not the robot's");
        if (!answer.ok) throw new Refusal(answer);
        [this.met, this.run, this.state, this.stateMs] = [met, runOf(reply.attachment), null, -Infinity];
        return;
      } catch (error) {
        why = error;
      }
    }
    throw why;
  }

  /** Request a verb. Returns the robot's reply and its attachment; throws a refusal. */
  async ask(verb, request) {
    const payload = encode(request);
    const [encoding, replyEncoding] = this.hello.requests[verb];
    const message = { key: this.key(verb), encoding, payload };
    const signed = this.signer ? await this.signer.attach(message, (await this.current()).challenge) : NOTHING;
    // The lease's tag, so that a flood of others' verbs does not delay it; that of an ended lease is ignored.
    const attachment = this.proof ? await this.proof.tag(message, signed) : signed;
    const replies = await this.link.ask({ is: "ask", robot: this.robot, operator: this.name, verb, payload, attachment });
    const answers = [];
    for (const reply of replies) {
      const own = { key: message.key, encoding: replyEncoding, payload: reply.payload };
      if (this.signer && !(await this.met.isReply(own, reply.attachment, attachment))) continue;
      answers.push([decode(reply.payload), reply.attachment]);
    }
    if (answers.length === 0) throw new Error(`${this.robot} does not answer ${verb}`);
    if (new Set(answers.map(([answer]) => `${answer.ok} ${answer.reason} ${answer.lease}`)).size > 1) throw new Error("the replies contradict each other: another gateway of this name, or an impostor, is there");
    if (!answers[0][0].ok) throw new Refusal(answers[0][0]);
    return answers[0];
  }

  /** The newest state, once a fresh one has arrived. */
  async current() {
    for (let left = 150; left > 0; left--) {
      if (performance.now() - this.stateMs < FRESH_MS) return this.state;
      await new Promise((resolve) => setTimeout(resolve, PERIOD_MS));
    }
    throw new Error(`no state to believe comes from ${this.robot}`);
  }

  /** Acquire or take the lease, engage, and stream from then on. */
  async begin(verb, more = {}) {
    await this.meet();
    await this.current();
    const [pair, ours] = this.signer ? await Lease.newKey() : [null, null];
    const [answer, attachment] = await this.ask(verb, { ...more, ...(ours && { public_key: ours }) });
    this.lease = answer.lease;
    try {
      this.proof = ours && (await Lease.agree(pair.privateKey, ours, answer.public_key, attachment, answer.lease, this.key("drive")));
      await this.standby();
      // The page was left meanwhile: do not engage a robot without a viewer.
      if (this.over) throw new Error("given up");
    } catch (error) {
      await this.release();
      throw error;
    }
    this.stream();
    try {
      const { challenge } = await this.current();
      await this.ask("engage", { lease: this.lease, challenge });
      await this.ask("unpark", { lease: this.lease });
    } catch (error) {
      await this.release();
      throw error;
    }
  }

  /** Wait for the end of a stop, holding the lease: a robot that was taken over stops first. */
  async standby() {
    for (let left = STOP_MS; (await this.current()).state !== "standby" && left > 0; left -= RENEW_MS) {
      await new Promise((resolve) => setTimeout(resolve, RENEW_MS));
      await this.ask("renew", { lease: this.lease });
    }
  }

  stream() {
    this.driving = true;
    this.wasEngaged = false;
    this.sequence = 0;
    this.angle = 0;
    this.tickMs = performance.now();
    this.timer = setInterval(() => this.tick(), PERIOD_MS);
  }

  /** Send the requested motion. Commands are signed one after the other, so that they keep their order. */
  async tick() {
    const nowMs = performance.now();
    const slept = nowMs - this.tickMs > ASLEEP_MS;
    this.tickMs = nowMs;
    if (slept) this.onsleep?.();
    if (!this.link.connected) return this.end("", "no contact with the desk");
    if (nowMs - this.stateMs > LOST_MS) return this.end("", `no contact with ${this.robot}`);
    // Without a fresh challenge nothing is sent: the robot stops by its deadman.
    if (nowMs - this.stateMs > FRESH_MS || this.sending) return;
    const wish = slept ? null : this.wish();
    // After letting go the wheels stay as they are: they are not turned on the spot.
    const { speed, angle } = wish ?? { speed: 0, angle: this.angle };
    this.angle = angle;
    const command = { lease: this.lease, seq: this.sequence++, challenge: this.state.challenge, speed_mps: speed, angle_deg: angle };
    const payload = encode(command);
    const message = { key: this.key("drive"), encoding: this.hello.requests.drive[0], payload };
    this.sending = true;
    try {
      const attachment = this.proof ? await this.proof.attach(message) : NOTHING;
      if (this.driving) this.link.send({ is: "drive", robot: this.robot, operator: this.name, payload, attachment });
    } finally {
      this.sending = false;
    }
  }

  /** Stop driving and release the lease, which a reset needs. */
  end(reason, detail) {
    if (!this.driving) return;
    this.driving = false;
    clearInterval(this.timer);
    this.release();
    this.onend(reason, detail);
  }

  /** Release the lease; an engaged robot stops. */
  async release() {
    const { lease } = this;
    this.lease = null;
    this.over = true;
    this.end("", "");
    if (lease === null) return;
    try {
      await this.ask("release", { lease });
    } catch {
      // It expires in two seconds.
    }
  }

  /** Reset the latches with a lease, and release it. @param of operator of the stop, if it is another one. */
  async reset(of) {
    await this.meet();
    await this.current();
    const [pair, ours] = this.signer ? await Lease.newKey() : [null, null];
    const [{ lease }] = await this.ask("acquire", ours ? { public_key: ours } : {});
    try {
      await this.ask("reset", { lease, ...(of && { of }) });
    } finally {
      await this.ask("release", { lease });
    }
  }
}
