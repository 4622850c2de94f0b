// SPDX-License-Identifier: Apache-2.0
// Drives a robot at half a metre a second for two seconds. Written from docs/commands.md and docs/authority.md alone.
//
// In open mode:
//
//     cargo install zenoh-bridge-remote-api
//     zenoh-bridge-remote-api --mode client --connect tcp/127.0.0.1:7447 --ws-port 127.0.0.1:10000
//     npm install && npm run build && npm start -- ws/127.0.0.1:10000 fleet/cruiser-1
//
// In signed mode, with the directory that `cruiser provision` left:
//
//     zenoh-bridge-remote-api --config ~/.config/cruiser/operator.json5 --ws-port 127.0.0.1:10000
//     npm start -- ws/127.0.0.1:10000 fleet/cruiser-1 ~/.config/cruiser
//
// zenoh-ts speaks WebSocket to the bridge above, or to a Zenoh router that has the plugin `remote-api`. Neither is
// trusted in signed mode: the key that signs stays here. Ends with 0 when the robot has driven and stands again.
// A program that drives must not be a browser tab: one in the background is slowed down, and the robot stops.

import { readFile } from "node:fs/promises";

import {
  type ChannelReceiver,
  Config,
  CongestionControl,
  ConsolidationMode,
  Duration,
  Priority,
  QueryTarget,
  type Reply,
  ReplyError,
  RingChannel,
  type Sample,
  Session,
  TryReceivedKind,
} from "@eclipse-zenoh/zenoh-ts";
import { decode, encode } from "@msgpack/msgpack";

import { Lease, type Message, Operator, Robot, isAhead, privateKeyOfPem, random, runOf } from "./proof.js";

const OPERATOR = "typescript-example"; // in open mode; in signed mode the grant has the name
const SPEED_MPS = 0.5;
const DRIVE_MS = 2000;
const PATIENCE_MS = 3000;

// The encodings that docs/commands.md and docs/messages.md give.
const schema = (name: string) => `application/msgpack;cruiser.${name}`;
const ACQUIRE = { request: schema("request.Acquire/1"), reply: schema("LeaseReply/1") };
const ENGAGE = { request: schema("request.Engage/2"), reply: schema("Reply/1") };
const UNPARK = { request: schema("request.Unpark/1"), reply: schema("Reply/1") };
const RELEASE = { request: schema("request.Release/1"), reply: schema("Reply/1") };
const DRIVE = schema("request.Drive/2");
const STATEMENT_REPLY = schema("StatementReply/1");
const SAFETY_STATE = schema("SafetyState/2");

/** The reply to any verb; `acquire` adds the lease, a statement that was shown the robot's own chain. */
interface Answer {
  ok: boolean;
  reason: string;
  detail: string;
  cure: string;
  lease?: number;
  public_key?: Uint8Array;
  own?: string;
}

/** The part of `safety/state` that a driver needs. */
interface SafetyState {
  sequence: number;
  challenge: Uint8Array;
  engaged: boolean;
  output_speed_mps: number;
  stop_reason: string;
  stop_detail: string;
}

interface Encodings {
  request: string;
  reply: string;
}

/** A request that was sent. */
interface Asked {
  key: string;
  encoding: string; // of the reply
  attachment: Uint8Array;
  replies: ChannelReceiver<Reply>;
}

const NOTHING = new Uint8Array();
const attachmentOf = (sample: Sample): Uint8Array => sample.attachment()?.toBytes() ?? NOTHING;

/** A refusal is an error that says what would cure it. */
function agreed(answer: Answer): Answer {
  if (!answer.ok) throw new Error(`${answer.detail}. Cure: ${answer.cure}`);
  return answer;
}

async function within<T>(endMs: number, promise: Promise<T>): Promise<T> {
  let timer: NodeJS.Timeout | undefined;
  const late = new Promise<never>((_, reject) => {
    const error = new Error("no state to believe comes from the robot");
    timer = setTimeout(() => reject(error), endMs - performance.now());
  });
  return Promise.race([promise, late]).finally(() => clearTimeout(timer));
}

/** The operator whose files `cruiser provision` left in this directory. */
async function operatorOf(directory: string): Promise<Operator> {
  const text = (name: string) => readFile(`${directory}/${name}`, "utf8");
  const { active } = JSON.parse(await text("authority.json"));
  return Operator.create(await privateKeyOfPem(await text("operator.key")), await text("operator.grant"), active);
}

async function replies(session: Session, key: string, options: object): Promise<ChannelReceiver<Reply>> {
  const receiver = await session.get(key, {
    ...options,
    target: QueryTarget.ALL, // else somebody who is nearer may answer in the robot's place
    consolidation: ConsolidationMode.NONE, // the reply as soon as it comes
    timeout: Duration.milliseconds.of(PATIENCE_MS),
  });
  if (receiver === undefined) throw new Error("a query without a handler has a receiver");
  return receiver;
}

/** What proves in signed mode who is at either end. */
interface Proof {
  operator: Operator;
  robot: Robot;
  run: Uint8Array; // that the robot is in
  newest?: number; // sequence of the newest state that was believed
}

/** Shows the robot the operator's grant. Its reply proves who it is. */
async function meet(session: Session, robot: string, operator: Operator): Promise<Proof> {
  const key = `${robot}/@auth`;
  const question = random(16); // a reply that somebody kept answers another one
  let reason: unknown = "no reply";
  for await (const reply of await replies(session, key, { payload: operator.statement, attachment: question })) {
    const sample = reply.result();
    if (sample instanceof ReplyError) continue;
    const payload = sample.payload().toBytes();
    try {
      const answer = decode(payload) as Answer;
      const met = await Robot.ofChain(answer.own ?? "", robot.split("/").pop() ?? "", operator.authority);
      const [message, attachment] = [{ key, encoding: STATEMENT_REPLY, payload }, attachmentOf(sample)];
      if (!(await met.isReply(message, attachment, question))) throw new Error("the reply is not the robot's");
      agreed(answer);
      return { operator, robot: met, run: runOf(attachment) };
    } catch (error) {
      reason = error;
    }
  }
  throw new Error(`${robot} is not met: ${reason}`);
}

/** One robot, commanded by one operator. */
class Link {
  private constructor(
    private readonly session: Session,
    private readonly robot: string,
    private readonly states: ChannelReceiver<Sample>,
    private readonly proof?: Proof, // not in open mode
  ) {}

  static async open(session: Session, robot: string, operator?: Operator): Promise<Link> {
    const proof = operator && (await meet(session, robot, operator));
    const subscriber = await session.declareSubscriber(`${robot}/safety/state`, { handler: new RingChannel(1) });
    const states = subscriber.receiver();
    if (states === undefined) throw new Error("a subscriber with a channel has a receiver");
    return new Link(session, robot, states, proof);
  }

  key(verb: string): string {
    return `${this.robot}/@cmd/${this.proof?.operator.name ?? OPERATOR}/${verb}`;
  }

  /** The newest state. In signed mode, what the robot did not sign in this run, or before, is passed over. */
  async newest(): Promise<SafetyState> {
    const endMs = performance.now() + PATIENCE_MS;
    for (;;) {
      const sample = await within(endMs, this.states.receive());
      const payload = sample.payload().toBytes();
      const message = { key: sample.keyexpr().toString(), encoding: SAFETY_STATE, payload };
      if (this.proof === undefined) return decode(payload) as SafetyState;
      if (!(await this.proof.robot.isPublication(message, attachmentOf(sample), this.proof.run))) continue;
      const state = decode(payload) as SafetyState;
      if (!isAhead(state.sequence, this.proof.newest)) continue;
      this.proof.newest = state.sequence;
      return state;
    }
  }

  /** The lease, where it is held, proves that the verb is its holder's. */
  async ask(
    verb: string,
    encoding: Encodings,
    request: object,
    challenge: Uint8Array,
    lease?: Lease,
  ): Promise<Asked> {
    const message: Message = { key: this.key(verb), encoding: encoding.request, payload: encode(request) };
    let attachment = await this.proof?.operator.attach(message, challenge);
    if (attachment && lease) attachment = await lease.tag(message, attachment);
    const options = { payload: message.payload, encoding: message.encoding, attachment };
    return {
      key: message.key,
      encoding: encoding.reply,
      attachment: attachment ?? NOTHING,
      replies: await replies(this.session, message.key, options),
    };
  }

  /** The answer with its attachment; none if it is not the robot's. A refusal is an error. */
  async answer(asked: Asked, reply: Reply): Promise<[Answer, Uint8Array] | undefined> {
    const sample = reply.result();
    if (sample instanceof ReplyError) return undefined;
    const message = { key: asked.key, encoding: asked.encoding, payload: sample.payload().toBytes() };
    const attachment = attachmentOf(sample);
    if (this.proof && !(await this.proof.robot.isReply(message, attachment, asked.attachment))) return undefined;
    return [agreed(decode(message.payload) as Answer), attachment];
  }

  async answered(asked: Asked): Promise<[Answer, Uint8Array]> {
    for await (const reply of asked.replies) {
      const answer = await this.answer(asked, reply);
      if (answer !== undefined) return answer;
    }
    throw new Error("no reply from the robot");
  }

  /** The number of a new lease, and in signed mode the lease itself, which proves drive commands. */
  async acquire(): Promise<[number, Lease?]> {
    const [pair, ours] = await Lease.newKey();
    const { challenge } = await this.newest();
    const request = this.proof === undefined ? {} : { public_key: ours };
    const [answer, attachment] = await this.answered(await this.ask("acquire", ACQUIRE, request, challenge));
    const { lease = 0, public_key: theirs } = answer;
    if (this.proof === undefined) return [lease];
    if (!theirs) throw new Error("the robot's reply has no key");
    return [lease, await Lease.agree(pair.privateKey, ours, theirs, attachment, lease, this.key("drive"))];
  }
}

async function drive(session: Session, link: Link): Promise<void> {
  const key = link.key("drive");
  const drives = await session.declarePublisher(key, {
    encoding: DRIVE,
    express: true,
    priority: Priority.INTERACTIVE_HIGH,
    congestionControl: CongestionControl.DROP,
  });
  const [lease, proof] = await link.acquire();
  const { challenge } = await link.newest();
  let asked = await link.ask("engage", ENGAGE, { lease, challenge, deadman_s: 0.8 }, challenge, proof);
  let isUnparked = false;
  let endMs: number | undefined; // not driving yet

  // 20 to 50 states a second pace the loop. The stream of commands begins before `engage` is replied to.
  for (let seq = 0; ; seq++) {
    const state = await link.newest();
    if (endMs === undefined) {
      const received = asked.replies.tryReceive();
      if (received.kind === TryReceivedKind.close) throw new Error("no reply from the robot");
      if (received.kind === TryReceivedKind.value && (await link.answer(asked, received.value))) {
        if (isUnparked) {
          endMs = performance.now() + DRIVE_MS;
        } else {
          asked = await link.ask("unpark", UNPARK, { lease }, state.challenge, proof);
          isUnparked = true;
        }
      }
    }
    const speed_mps = endMs !== undefined && performance.now() < endMs ? SPEED_MPS : 0;
    const payload = encode({ lease, seq, challenge: state.challenge, speed_mps, angle_deg: 0 });
    await drives.put(payload, { attachment: await proof?.attach({ key, encoding: DRIVE, payload }) });
    if (endMs !== undefined && !state.engaged) throw new Error(`stopped: ${state.stop_reason}; ${state.stop_detail}`);
    if (endMs !== undefined && speed_mps === 0 && state.output_speed_mps === 0) break;
  }
  const newest = await link.newest();
  await link.answered(await link.ask("release", RELEASE, { lease }, newest.challenge, proof));
}

const [locator = "ws/127.0.0.1:10000", robot = "fleet/cruiser-1", directory] = process.argv.slice(2);
const operator = directory === undefined ? undefined : await operatorOf(directory);
const session = await Session.open(new Config(locator));
try {
  await drive(session, await Link.open(session, robot, operator));
  console.log("driven");
} finally {
  await session.close();
}
