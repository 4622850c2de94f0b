// SPDX-License-Identifier: Apache-2.0
// Drives a robot at half a metre a second for two seconds. Written from docs/commands.md alone.
//
//     cargo install zenoh-bridge-remote-api
//     zenoh-bridge-remote-api --mode client --connect tcp/127.0.0.1:7447 --ws-port 127.0.0.1:10000
//     npm install && npm run build && npm start -- ws/127.0.0.1:10000 fleet/cruiser-1
//
// zenoh-ts speaks WebSocket to a Zenoh router that has the plugin `remote-api`, or to the bridge above. It was run so with
// zenoh-ts 1.10.1 and Node.js 20, against a robot of the tests; the tests do not repeat that.
// A program that drives must not be a browser tab: one in the background is slowed down, and the robot stops.

import {
  type ChannelReceiver,
  Config,
  CongestionControl,
  ConsolidationMode,
  Duration,
  Priority,
  type Reply,
  ReplyError,
  RingChannel,
  Session,
  TryReceivedKind,
} from "@eclipse-zenoh/zenoh-ts";
import { decode, encode } from "@msgpack/msgpack";

const [locator = "ws/127.0.0.1:10000", robot = "fleet/cruiser-1"] = process.argv.slice(2);
const OPERATOR = "typescript-example";
const SPEED_MPS = 0.5;
const DRIVE_MS = 2000;

/** The reply to any verb; `acquire` adds the lease. */
interface Answer {
  ok: boolean;
  reason: string;
  detail: string;
  cure: string;
  lease?: number;
}

/** The part of `safety/state` that a driver needs. */
interface SafetyState {
  challenge: Uint8Array;
  engaged: boolean;
  output_speed_mps: number;
  stop_reason: string;
  stop_detail: string;
}

async function ask(session: Session, verb: string, request: object): Promise<ChannelReceiver<Reply>> {
  const replies = await session.get(`${robot}/@cmd/${OPERATOR}/${verb}`, {
    payload: encode(request),
    consolidation: ConsolidationMode.NONE, // the reply as soon as it comes
    timeout: Duration.seconds.of(3),
  });
  if (replies === undefined) throw new Error("a query without a handler has a receiver");
  return replies;
}

/** The answer; a refusal is an error that says what would cure it. */
function agreed(reply: Reply): Answer {
  const result = reply.result();
  if (result instanceof ReplyError) throw new Error("no reply from the robot");
  const answer = decode(result.payload().toBytes()) as Answer;
  if (!answer.ok) throw new Error(`${answer.detail}. Cure: ${answer.cure}`);
  return answer;
}

async function drive(session: Session): Promise<void> {
  const subscriber = await session.declareSubscriber(`${robot}/safety/state`, { handler: new RingChannel(1) });
  const states = subscriber.receiver();
  if (states === undefined) throw new Error("a subscriber with a channel has a receiver");
  const newest = async () => decode((await states.receive()).payload().toBytes()) as SafetyState;
  const drives = await session.declarePublisher(`${robot}/@cmd/${OPERATOR}/drive`, {
    express: true,
    priority: Priority.INTERACTIVE_HIGH,
    congestionControl: CongestionControl.DROP,
  });

  await newest(); // the robot is there
  const { lease } = agreed(await (await ask(session, "acquire", {})).receive());
  const { challenge } = await newest();
  let replies = await ask(session, "engage", { lease, challenge, deadman_s: 0.8 });
  let nextVerb: string | undefined = "unpark";
  let endMs: number | undefined; // not driving yet

  // 20 to 50 states a second pace the loop. The stream of commands begins before `engage` is replied to.
  for (let seq = 0; ; seq++) {
    const state = await newest();
    if (endMs === undefined) {
      const received = replies.tryReceive();
      if (received.kind === TryReceivedKind.value) {
        agreed(received.value);
        if (nextVerb !== undefined) {
          replies = await ask(session, nextVerb, { lease });
          nextVerb = undefined;
        } else {
          endMs = performance.now() + DRIVE_MS;
        }
      }
    }
    const speed_mps = endMs !== undefined && performance.now() < endMs ? SPEED_MPS : 0;
    await drives.put(encode({ lease, seq, challenge: state.challenge, speed_mps, angle_deg: 0 }));
    if (endMs !== undefined && !state.engaged) throw new Error(`stopped: ${state.stop_reason}; ${state.stop_detail}`);
    if (endMs !== undefined && speed_mps === 0 && state.output_speed_mps === 0) break;
  }
  agreed(await (await ask(session, "release", { lease })).receive());
}

const session = await Session.open(new Config(locator));
try {
  await drive(session);
  console.log("driven");
} finally {
  await session.close();
}
