// SPDX-License-Identifier: Apache-2.0
//! Drives a robot at half a metre a second for two seconds. Written from docs/commands.md alone.
//!
//!     cargo run -- tcp/127.0.0.1:7447 fleet/cruiser-1
//!
//! Ends with 0 when the robot has driven and stands again, and with 1 and the reason when it was refused or stopped.

use std::error::Error;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use zenoh::handlers::{FifoChannelHandler, RingChannel};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::{Config, Session};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const OPERATOR: &str = "rust-example";
const SPEED_MPS: f64 = 0.5;
const DRIVE_FOR: Duration = Duration::from_secs(2);

/// A request with no field.
#[derive(Serialize)]
struct Acquire {}

/// What every further request carries, and `unpark` and `release` alone.
#[derive(Serialize)]
struct Leased {
    lease: u64,
}

#[derive(Serialize)]
struct Engage<'a> {
    lease: u64,
    challenge: &'a ByteBuf,
    deadman_s: f64,
}

#[derive(Serialize)]
struct Drive<'a> {
    lease: u64,
    seq: u64,
    challenge: &'a ByteBuf,
    speed_mps: f64,
    angle_deg: f64,
}

/// The reply to any verb; `acquire` adds the lease.
#[derive(Deserialize)]
struct Answer {
    ok: bool,
    detail: String,
    cure: String,
    #[serde(default)]
    lease: u64,
}

/// The part of `safety/state` that a driver needs; fields that are not named here are ignored.
#[derive(Deserialize)]
struct SafetyState {
    challenge: ByteBuf,
    engaged: bool,
    output_speed_mps: f64,
    stop_reason: String,
    stop_detail: String,
}

type Replies = FifoChannelHandler<Reply>;

async fn ask(session: &Session, robot: &str, verb: &str, request: &impl Serialize) -> Outcome<Replies> {
    let key = format!("{robot}/@cmd/{OPERATOR}/{verb}");
    session
        .get(key)
        .payload(rmp_serde::to_vec_named(request)?)
        .consolidation(ConsolidationMode::None) // the reply as soon as it comes
        .timeout(Duration::from_secs(3))
        .await
}

/// The lease, or 0 where the verb gives none; a refusal is an error that says what would cure it.
fn agreed(reply: Reply) -> Outcome<u64> {
    let sample = reply.into_result().map_err(|_| "no reply from the robot")?;
    let answer: Answer = rmp_serde::from_slice(&sample.payload().to_bytes())?;
    if answer.ok {
        Ok(answer.lease)
    } else {
        Err(format!("{}. Cure: {}", answer.detail, answer.cure).into())
    }
}

#[tokio::main]
async fn main() -> Outcome<()> {
    let mut words = std::env::args().skip(1);
    let endpoint = words.next().unwrap_or("tcp/127.0.0.1:7447".into());
    let robot = words.next().unwrap_or("fleet/cruiser-1".into());
    let client = format!(
        r#"{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}"#
    );
    let session = zenoh::open(Config::from_json5(&client)?).await?;
    let states = session
        .declare_subscriber(format!("{robot}/safety/state"))
        .with(RingChannel::new(1))
        .await?;
    let newest = || async {
        let sample = states.recv_async().await?;
        Outcome::<SafetyState>::Ok(rmp_serde::from_slice(&sample.payload().to_bytes())?)
    };
    let drives = session
        .declare_publisher(format!("{robot}/@cmd/{OPERATOR}/drive"))
        .express(true)
        .priority(Priority::InteractiveHigh)
        .congestion_control(CongestionControl::Drop)
        .await?;

    newest().await?; // the robot is there
    let lease = agreed(ask(&session, &robot, "acquire", &Acquire {}).await?.recv_async().await?)?;
    let challenge = &newest().await?.challenge;
    let request = Engage { lease, challenge, deadman_s: 0.8 };
    let mut replies = ask(&session, &robot, "engage", &request).await?;
    let mut next_verb = Some("unpark");
    let mut end: Option<Instant> = None; // not driving yet

    // 20 to 50 states a second pace the loop. The stream of commands begins before `engage` is replied to.
    for seq in 0u64.. {
        let state = newest().await?;
        if end.is_none() {
            if let Some(reply) = replies.try_recv()? {
                agreed(reply)?;
                match next_verb.take() {
                    Some(verb) => replies = ask(&session, &robot, verb, &Leased { lease }).await?,
                    None => end = Some(Instant::now() + DRIVE_FOR),
                }
            }
        }
        let speed_mps = if end.is_some_and(|end| Instant::now() < end) { SPEED_MPS } else { 0.0 };
        let drive = Drive { lease, seq, challenge: &state.challenge, speed_mps, angle_deg: 0.0 };
        drives.put(rmp_serde::to_vec_named(&drive)?).await?;
        if end.is_some() && !state.engaged {
            return Err(format!("stopped: {}; {}", state.stop_reason, state.stop_detail).into());
        }
        if end.is_some() && speed_mps == 0.0 && state.output_speed_mps == 0.0 {
            break;
        }
    }
    agreed(ask(&session, &robot, "release", &Leased { lease }).await?.recv_async().await?)?;
    session.close().await?;
    println!("driven");
    Ok(())
}
