// SPDX-License-Identifier: Apache-2.0
//! Drives a robot at half a metre a second for two seconds. Written from docs/commands.md and docs/authority.md alone.
//!
//!     cargo run -- tcp/127.0.0.1:7447 fleet/cruiser-1      in open mode
//!     cargo run -- ~/.config/cruiser fleet/cruiser-1       in signed mode, as `cruiser provision` left the directory
//!
//! Ends with 0 when the robot has driven and stands again, and with 1 and the reason when it was refused or stopped.

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use cruiser_proof::{Id, Lease, Message, Operator, Robot, is_ahead, run_of};
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use x25519_dalek::{PublicKey, StaticSecret};
use zenoh::handlers::{FifoChannelHandler, RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::sample::Sample;
use zenoh::{Config, Session};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const OPERATOR: &str = "rust-example"; // in open mode; in signed mode the grant has the name
const SPEED_MPS: f64 = 0.5;
const DRIVE_FOR: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(3);

// The encodings that docs/commands.md and docs/messages.md give.
const ACQUIRE: &str = "application/msgpack;cruiser.request.Acquire/1";
const ENGAGE: &str = "application/msgpack;cruiser.request.Engage/2";
const UNPARK: &str = "application/msgpack;cruiser.request.Unpark/1";
const RELEASE: &str = "application/msgpack;cruiser.request.Release/1";
const DRIVE: &str = "application/msgpack;cruiser.request.Drive/2";
const REPLY: &str = "application/msgpack;cruiser.Reply/1";
const LEASE_REPLY: &str = "application/msgpack;cruiser.LeaseReply/1";
const STATEMENT_REPLY: &str = "application/msgpack;cruiser.StatementReply/1";
const SAFETY_STATE: &str = "application/msgpack;cruiser.SafetyState/2";

#[derive(Serialize)]
struct Acquire {
    #[serde(skip_serializing_if = "Option::is_none")] // in open mode
    public_key: Option<ByteBuf>,
}

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

/// The reply to any verb; `acquire` adds the lease, a statement that was shown the robot's own chain.
#[derive(Deserialize)]
struct Answer {
    ok: bool,
    detail: String,
    cure: String,
    #[serde(default)]
    lease: u64,
    #[serde(default)]
    public_key: Option<ByteBuf>,
    #[serde(default)]
    own: String,
}

impl Answer {
    /// A refusal is an error that says what would cure it.
    fn agreed(self) -> Outcome<Self> {
        if self.ok { Ok(self) } else { Err(format!("{}. Cure: {}", self.detail, self.cure).into()) }
    }
}

/// The part of `safety/state` that a driver needs; fields that are not named here are ignored.
#[derive(Deserialize)]
struct SafetyState {
    sequence: u32,
    challenge: ByteBuf,
    engaged: bool,
    output_speed_mps: f64,
    stop_reason: String,
    stop_detail: String,
}

/// A request that was sent.
struct Asked {
    key: String,
    encoding: &'static str, // of the reply
    attachment: Vec<u8>,
    replies: FifoChannelHandler<Reply>,
}

/// What proves in signed mode who is at either end.
struct Proof {
    operator: Operator,
    robot: Robot,
    run: Id,             // that the robot is in
    newest: Option<u32>, // sequence of the newest state that was believed
}

/// One robot, commanded by one operator.
struct Link {
    session: Session,
    robot: String,
    operator: String,
    proof: Option<Proof>, // none in open mode
    states: Subscriber<RingChannelHandler<Sample>>,
}

impl Link {
    /// The link to a robot by an endpoint (open mode), or by the files of a directory (signed mode).
    async fn open(place: &str, robot: String) -> Outcome<Self> {
        let directory = Path::new(place);
        let known = directory.is_dir().then(|| Operator::read(directory)).transpose()?;
        let config = match known {
            Some(_) => Config::from_file(directory.join("operator.json5"))?,
            None => Config::from_json5(&format!(
                r#"{{mode: "client", connect: {{endpoints: ["{place}"]}}, scouting: {{multicast: {{enabled: false}}}}}}"#
            ))?,
        };
        let session = zenoh::open(config).await?;
        let proof = match known {
            Some(operator) => Some(meet(&session, &robot, operator).await?),
            None => None,
        };
        let operator = proof.as_ref().map_or(OPERATOR, |proof| &proof.operator.name).into();
        let states = session.declare_subscriber(format!("{robot}/safety/state")).with(RingChannel::new(1)).await?;
        Ok(Self { session, robot, operator, proof, states })
    }

    fn key(&self, verb: &str) -> String {
        format!("{}/@cmd/{}/{verb}", self.robot, self.operator)
    }

    /// The newest state. In signed mode, what the robot did not sign in this run, or before, is passed over.
    async fn newest(&mut self) -> Outcome<SafetyState> {
        let end = Instant::now() + PATIENCE;
        loop {
            let sample = tokio::time::timeout_at(end.into(), self.states.recv_async())
                .await
                .map_err(|_| "no state to believe comes from the robot")??;
            let payload = sample.payload().to_bytes();
            let message = Message { key: sample.key_expr(), encoding: SAFETY_STATE, payload: &payload };
            if let Some(proof) = &self.proof {
                if !proof.robot.is_publication(&message, &attachment_of(&sample), &proof.run) {
                    continue;
                }
            }
            let state: SafetyState = rmp_serde::from_slice(&payload)?;
            if let Some(proof) = &mut self.proof {
                if !is_ahead(state.sequence, proof.newest) {
                    continue;
                }
                proof.newest = Some(state.sequence);
            }
            return Ok(state);
        }
    }

    /// The lease, where it is held, proves that the verb is its holder's.
    async fn ask(
        &self,
        verb: &str,
        encodings: (&'static str, &'static str),
        request: &impl Serialize,
        challenge: &ByteBuf,
        lease: Option<&Lease>,
    ) -> Outcome<Asked> {
        let (key, payload) = (self.key(verb), rmp_serde::to_vec_named(request)?);
        let mut query = self
            .session
            .get(&key)
            .target(QueryTarget::All) // else somebody who is nearer may answer in the robot's place
            .consolidation(ConsolidationMode::None) // the reply as soon as it comes
            .timeout(PATIENCE);
        let mut attachment = vec![];
        if let Some(proof) = &self.proof {
            let mut nonce = Id::default();
            getrandom::fill(&mut nonce)?;
            let message = Message { key: &key, encoding: encodings.0, payload: &payload };
            attachment = proof.operator.attach(&message, challenge.as_slice().try_into()?, &nonce);
            if let Some(lease) = lease {
                attachment = lease.tag(&message, &attachment);
            }
            query = query.attachment(&attachment);
        }
        let replies = query.payload(payload).encoding(encodings.0).await?;
        Ok(Asked { key, encoding: encodings.1, attachment, replies })
    }

    /// The answer with its attachment; none if it is not the robot's. A refusal is an error.
    fn answer(&self, asked: &Asked, reply: Reply) -> Outcome<Option<(Answer, Vec<u8>)>> {
        let Ok(sample) = reply.into_result() else { return Ok(None) };
        let (payload, attachment) = (sample.payload().to_bytes(), attachment_of(&sample));
        let message = Message { key: &asked.key, encoding: asked.encoding, payload: &payload };
        if let Some(proof) = &self.proof {
            if !proof.robot.is_reply(&message, &attachment, &asked.attachment) {
                return Ok(None);
            }
        }
        Ok(Some((rmp_serde::from_slice::<Answer>(&payload)?.agreed()?, attachment)))
    }

    async fn answered(&self, asked: Asked) -> Outcome<(Answer, Vec<u8>)> {
        loop {
            let reply = asked.replies.recv_async().await.map_err(|_| "no reply from the robot")?;
            if let Some(answer) = self.answer(&asked, reply)? {
                return Ok(answer);
            }
        }
    }

    /// The number of a new lease, and in signed mode the lease itself, which proves drive commands.
    async fn acquire(&mut self) -> Outcome<(u64, Option<Lease>)> {
        let private = StaticSecret::random();
        let public = PublicKey::from(&private).as_bytes().to_vec();
        let request = Acquire { public_key: self.proof.as_ref().map(|_| public.into()) };
        let challenge = self.newest().await?.challenge;
        let asked = self.ask("acquire", (ACQUIRE, LEASE_REPLY), &request, &challenge, None).await?;
        let (answer, attachment) = self.answered(asked).await?;
        if self.proof.is_none() {
            return Ok((answer.lease, None));
        }
        let public = answer.public_key.ok_or("the robot's reply has no key")?;
        let lease = Lease::agree(private, &public, &run_of(&attachment)?, answer.lease, &self.key("drive"))?;
        Ok((answer.lease, Some(lease)))
    }
}

/// Shows the robot the operator's grant. Its reply proves who it is.
async fn meet(session: &Session, robot: &str, operator: Operator) -> Outcome<Proof> {
    let key = format!("{robot}/@auth");
    let name = robot.rsplit('/').next().unwrap_or_default();
    let now_s = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs();
    let mut question = [0; 16]; // a reply that somebody kept answers another one
    getrandom::fill(&mut question)?;
    let query = session.get(&key).payload(operator.statement.as_str()).attachment(&question).timeout(PATIENCE);
    let replies = query.target(QueryTarget::All).consolidation(ConsolidationMode::None).await?;
    let mut reason = "no reply".to_string();
    while let Ok(reply) = replies.recv_async().await {
        let Ok(sample) = reply.into_result() else { continue };
        let payload = sample.payload().to_bytes();
        let Ok(answer) = rmp_serde::from_slice::<Answer>(&payload) else { continue };
        match Robot::of_chain(&answer.own, name, &operator.authority, now_s) {
            Ok(met) => {
                let message = Message { key: &key, encoding: STATEMENT_REPLY, payload: &payload };
                let attachment = attachment_of(&sample);
                if met.is_reply(&message, &attachment, &question) {
                    answer.agreed()?;
                    return Ok(Proof { operator, robot: met, run: run_of(&attachment)?, newest: None });
                }
            }
            Err(error) => reason = error.to_string(),
        }
    }
    Err(format!("{robot} is not met: {reason}").into())
}

fn attachment_of(sample: &Sample) -> Vec<u8> {
    sample.attachment().map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default()
}

#[tokio::main]
async fn main() -> Outcome<()> {
    let mut words = std::env::args().skip(1);
    let place = words.next().unwrap_or("tcp/127.0.0.1:7447".into());
    let robot = words.next().unwrap_or("fleet/cruiser-1".into());
    let mut link = Link::open(&place, robot).await?;
    let drive_key = link.key("drive");
    let drives = link
        .session
        .declare_publisher(&drive_key)
        .encoding(DRIVE)
        .express(true)
        .priority(Priority::InteractiveHigh)
        .congestion_control(CongestionControl::Drop)
        .await?;

    let (lease, proof) = link.acquire().await?;
    let proof = proof.as_ref();
    let challenge = link.newest().await?.challenge;
    let request = Engage { lease, challenge: &challenge, deadman_s: 0.8 };
    let mut asked = link.ask("engage", (ENGAGE, REPLY), &request, &challenge, proof).await?;
    let mut is_unparked = false;
    let mut end: Option<Instant> = None; // not driving yet

    // 20 to 50 states a second pace the loop. The stream of commands begins before `engage` is replied to.
    for seq in 0u64.. {
        let state = link.newest().await?;
        if end.is_none() {
            if let Some(reply) = asked.replies.try_recv().map_err(|_| "no reply from the robot")? {
                if link.answer(&asked, reply)?.is_some() {
                    if is_unparked {
                        end = Some(Instant::now() + DRIVE_FOR);
                    } else {
                        let request = Leased { lease };
                        asked = link.ask("unpark", (UNPARK, REPLY), &request, &state.challenge, proof).await?;
                        is_unparked = true;
                    }
                }
            }
        }
        let speed_mps = if end.is_some_and(|end| Instant::now() < end) { SPEED_MPS } else { 0.0 };
        let drive = Drive { lease, seq, challenge: &state.challenge, speed_mps, angle_deg: 0.0 };
        let payload = rmp_serde::to_vec_named(&drive)?;
        let message = Message { key: &drive_key, encoding: DRIVE, payload: &payload };
        let attachment = proof.map(|lease| lease.attach(&message));
        drives.put(&payload).attachment(attachment).await?;
        if end.is_some() && !state.engaged {
            return Err(format!("stopped: {}; {}", state.stop_reason, state.stop_detail).into());
        }
        if end.is_some() && speed_mps == 0.0 && state.output_speed_mps == 0.0 {
            break;
        }
    }
    let challenge = link.newest().await?.challenge;
    let released = link.ask("release", (RELEASE, REPLY), &Leased { lease }, &challenge, proof).await?;
    link.answered(released).await?;
    link.session.close().await?;
    println!("driven");
    Ok(())
}
